//! What pictures are written as: SVG, and what is made of it.
//!
//! Every picture is drawn as SVG. PNG is drawn of it at 288 points an inch, PDF keeps its lines and its text; both with the
//! font that is built in, so that they look the same on every machine.

use super::raster::Cells;
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::OnceLock;

/// A format of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Scalable, for screens and for changing it.
    Svg,
    /// Pixels.
    #[cfg(feature = "pictures")]
    Png,
    /// For papers.
    #[cfg(feature = "pictures")]
    Pdf,
}

impl FromStr for Format {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = Self::ALL;
        let names = || all.map(Self::name).join(", ");
        let found = all.into_iter().find(|format| format.name() == text);
        found.ok_or_else(|| format!("pictures are written as {}", names()))
    }
}

impl Format {
    #[cfg(feature = "pictures")]
    const ALL: [Self; 3] = [Self::Svg, Self::Png, Self::Pdf];
    #[cfg(not(feature = "pictures"))]
    const ALL: [Self; 1] = [Self::Svg];

    /// What files of it end in.
    pub fn name(self) -> &'static str {
        match self {
            Self::Svg => "svg",
            #[cfg(feature = "pictures")]
            Self::Png => "png",
            #[cfg(feature = "pictures")]
            Self::Pdf => "pdf",
        }
    }

    /// The bytes of a picture.
    fn of(self, svg: &str) -> Result<Vec<u8>> {
        match self {
            Self::Svg => Ok(svg.as_bytes().to_vec()),
            #[cfg(feature = "pictures")]
            Self::Png => drawn::png(svg),
            #[cfg(feature = "pictures")]
            Self::Pdf => drawn::pdf(svg),
        }
    }
}

static WANTED: OnceLock<Vec<Format>> = OnceLock::new();

/// From now on pictures of which nobody says what they are written as are written as all of these. The first time counts.
pub fn write_as(formats: &[Format]) {
    WANTED.get_or_init(|| formats.to_vec());
}

/// Which files a picture is written to: of its own name, or where that is `.svg`, of what is wanted of all.
///
/// # Errors
/// The name ends as no picture's does.
fn files(path: &Path) -> Result<Vec<(Format, PathBuf)>> {
    let named = path
        .extension()
        .and_then(|e| e.to_str())
        .and_then(|e| Format::from_str(&e.to_ascii_lowercase()).ok());
    if let (None, Some(ending)) = (named, path.extension()) {
        bail!(
            "{}: no picture is written as .{}; .svg, .png and .pdf are",
            path.display(),
            ending.to_string_lossy()
        );
    }
    let wanted = WANTED.get().map_or(&[Format::Svg][..], Vec::as_slice);
    let formats = match named {
        Some(Format::Svg) => wanted,
        // There is one file of this name.
        None => wanted.get(..1).unwrap_or(wanted),
        #[cfg(feature = "pictures")]
        Some(Format::Png) => &[Format::Png],
        #[cfg(feature = "pictures")]
        Some(Format::Pdf) => &[Format::Pdf],
    };
    let file = |format: &Format| {
        let other = named.is_some_and(|named| named != *format);
        (*format, if other { path.with_extension(format.name()) } else { path.to_owned() })
    };
    Ok(formats.iter().map(file).collect())
}

/// Names of the files that a picture of this name is written to; none where no picture is named so.
pub fn names_of(path: &Path) -> Vec<PathBuf> {
    files(path).map_or_else(|_| Vec::new(), |files| files.into_iter().map(|(_, path)| path).collect())
}

/// Writes a picture, atomically: as its name says, or where that is `.svg`, as is wanted of all.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write(path: &Path, drawn: impl Fn(Cells) -> Result<String>) -> Result<()> {
    files(path)?.iter().try_for_each(|(format, path)| {
        let cells = if *format == Format::Svg { Cells::Image } else { Cells::Rectangles };
        crate::atomic::write(path, &format.of(&drawn(cells)?)?)
    })
}

#[cfg(feature = "pictures")]
mod drawn {
    use anyhow::{Context, Result, anyhow};
    use resvg::tiny_skia::{Pixmap, Transform};
    use resvg::usvg::{Options, Tree, fontdb};
    use std::sync::{Arc, OnceLock};

    /// Pixels for one of the SVG's, of which there are 96 in an inch.
    const SCALE: f32 = 3.0;

    fn fonts() -> Arc<fontdb::Database> {
        static FONTS: OnceLock<Arc<fontdb::Database>> = OnceLock::new();
        let load = || {
            let mut fonts = fontdb::Database::new();
            fonts.load_font_data(dejavu::sans::regular().to_vec());
            fonts.load_font_data(dejavu::sans::bold().to_vec());
            fonts.set_sans_serif_family("DejaVu Sans");
            Arc::new(fonts)
        };
        Arc::clone(FONTS.get_or_init(load))
    }

    fn tree(svg: &str) -> Result<Tree> {
        let options = Options { fontdb: fonts(), font_family: "DejaVu Sans".into(), ..Options::default() };
        Tree::from_str(svg, &options).context("a picture could not be read again")
    }

    pub(super) fn png(svg: &str) -> Result<Vec<u8>> {
        let tree = tree(svg)?;
        let size = tree.size().to_int_size().scale_by(SCALE).context("a picture without a size")?;
        let mut pixels = Pixmap::new(size.width(), size.height()).context("a picture without a size")?;
        resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
        pixels.encode_png().context("a picture could not be written as PNG")
    }

    pub(super) fn pdf(svg: &str) -> Result<Vec<u8>> {
        let page = svg2pdf::PageOptions { dpi: 96.0 };
        svg2pdf::to_pdf(&tree(svg)?, svg2pdf::ConversionOptions::default(), page)
            .map_err(|e| anyhow!("a picture could not be written as PDF: {e}"))
    }
}

#[cfg(all(test, feature = "pictures"))]
mod tests {
    use super::*;
    use crate::plot::Plot;

    #[test]
    fn a_picture_is_what_its_name_says() {
        let folder = tempfile::tempdir().unwrap();
        let mut plot = Plot::new("Azimuth", "time (s)", "azimuth (°)");
        plot.line("truth", &[(0.0, 1.0), (1.0, 2.0)]);
        let write = |name: &str| {
            let path = folder.path().join(name);
            plot.write(&path).unwrap();
            std::fs::read(path).unwrap()
        };
        assert!(write("a.svg").starts_with(b"<svg"));
        let png = write("a.png");
        assert!(png.starts_with(b"\x89PNG"));
        let width = u32::from_be_bytes([png[16], png[17], png[18], png[19]]);
        assert!((1500..4000).contains(&width), "{width}");
        let pdf = write("a.pdf");
        assert!(pdf.starts_with(b"%PDF-"));
        // Its words are text, of the font that is built in.
        assert!(pdf.windows(6).any(|w| w == b"DejaVu"));
        assert!(write("b.PNG").starts_with(b"\x89PNG") && write("b").starts_with(b"<svg"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 5);
        assert!(Format::from_str("gif").unwrap_err().contains("svg, png, pdf"));
    }
}
