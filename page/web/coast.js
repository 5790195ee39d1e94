// A coastline out of a file.

// Rings and lines of a GeoJSON text, longitude first.
export function coastline(text) {
  const rings = [];
  const line = (ring, closed) => {
    const good = ring.filter((p) => Array.isArray(p) && Number.isFinite(p[0]) && Math.abs(p[1]) <= 90);
    if (good.length > 1) rings.push({ ring: good, closed });
  };
  const walk = (g) => {
    switch (g?.type) {
      case 'FeatureCollection': return g.features.forEach(walk);
      case 'Feature': return walk(g.geometry);
      case 'GeometryCollection': return g.geometries.forEach(walk);
      case 'LineString': return line(g.coordinates, false);
      case 'MultiLineString': return g.coordinates.forEach((r) => line(r, false));
      case 'Polygon': return g.coordinates.forEach((r) => line(r, true));
      case 'MultiPolygon': return g.coordinates.forEach((p) => p.forEach((r) => line(r, true)));
      default: return undefined;
    }
  };
  walk(JSON.parse(text));
  if (!rings.length) throw new Error('it holds no lines or polygons');
  return { rings, drawn: null };
}
