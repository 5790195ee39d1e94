// Places on the globe as metres on a plane around the stations' middle: azimuthal equidistant, which holds at the poles and
// across the date line. The sphere has the ellipsoid's mean radius at the middle: lengths are true to 0.3 %.

const RAD = Math.PI / 180;

// The middle of places [lat, lon] in degrees, whatever line they cross; of places that cancel out the first.
export function middle(places) {
  let [x, y, z] = [0, 0, 0];
  for (const [lat, lon] of places) {
    x += Math.cos(lat * RAD) * Math.cos(lon * RAD);
    y += Math.cos(lat * RAD) * Math.sin(lon * RAD);
    z += Math.sin(lat * RAD);
  }
  if (Math.hypot(x, y, z) < 1e-6 * places.length) return places[0] ?? [0, 0];
  return [Math.atan2(z, Math.hypot(x, y)) / RAD, Math.atan2(y, x) / RAD];
}

// Radius of the sphere that fits the ellipsoid (WGS 84) at a latitude, m.
function radius(lat) {
  const [a, e2] = [6378137, 0.00669437999014];
  return (a * Math.sqrt(1 - e2)) / (1 - e2 * Math.sin(lat * RAD) ** 2);
}

export class Plane {
  constructor([lat, lon]) {
    this.at = [lat, lon];
    this.radius = radius(lat);
    this.sin = Math.sin(lat * RAD);
    this.cos = Math.cos(lat * RAD);
  }

  // Metres East and North of the middle.
  xy(lat, lon) {
    const [phi, turn] = [lat * RAD, (lon - this.at[1]) * RAD];
    const [s, c] = [Math.sin(phi), Math.cos(phi)];
    const east = c * Math.sin(turn);
    const north = this.cos * s - this.sin * c * Math.cos(turn);
    const up = this.sin * s + this.cos * c * Math.cos(turn);
    const far = Math.hypot(east, north);
    const k = far < 1e-12 ? (up > 0 ? 1 : 0) : Math.atan2(far, up) / far;
    return [this.radius * k * east, this.radius * k * north];
  }

  // Latitude and longitude of a place on the plane, degrees.
  place(x, y) {
    const angle = Math.hypot(x, y) / this.radius;
    if (angle < 1e-12) return [...this.at];
    return step(this.at, Math.atan2(x, y), angle);
  }

  // A place so many metres East and North of a station at [lat, lon], on the plane.
  near(station, east, north) {
    const angle = Math.hypot(east, north) / this.radius;
    if (angle < 1e-12) return this.xy(...station);
    return this.xy(...step(station, Math.atan2(east, north), angle));
  }
}

// Where a great circle leads from [lat, lon] in a direction (radians from North) after an angle.
function step([lat, lon], azimuth, angle) {
  const phi = lat * RAD;
  const s = Math.sin(phi) * Math.cos(angle) + Math.cos(phi) * Math.sin(angle) * Math.cos(azimuth);
  const turn = Math.atan2(Math.sin(azimuth) * Math.sin(angle) * Math.cos(phi), Math.cos(angle) - Math.sin(phi) * s);
  const to = lon + turn / RAD;
  return [Math.asin(Math.min(1, Math.max(-1, s))) / RAD, ((((to + 180) % 360) + 360) % 360) - 180];
}
