//! Writing output files so that a reader never sees half of one: a temporary file beside it, then a rename.

use anyhow::{Context, Result};
use std::io::Write;
use std::path::Path;

/// Writes a whole file atomically; its folder is made if missing.
///
/// # Errors
/// The folder or file cannot be written; the line names the path.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |out| Ok(out.write_all(bytes)?))
}

/// Writes a file atomically through a buffered writer; nothing is left behind if `fill` fails.
///
/// # Errors
/// The folder or file cannot be written, or `fill` says so.
pub fn write_with(
    path: &Path,
    fill: impl FnOnce(&mut std::io::BufWriter<&std::fs::File>) -> Result<()>,
) -> Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let cannot = || format!("cannot write {}", path.display());
    std::fs::create_dir_all(folder).with_context(cannot)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".seabearing-");
    // Temporary files are private by default; results should be as readable as any other file (less the umask).
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.tempfile_in(folder).with_context(cannot)?;
    {
        let mut out = std::io::BufWriter::with_capacity(1 << 16, file.as_file());
        fill(&mut out)?;
        out.flush().with_context(cannot)?;
    }
    file.persist(path).map_err(|e| e.error).with_context(cannot)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("new/folder/x.txt");
        write(&path, b"old").unwrap();
        assert!(
            write_with(&path, |out| Ok(out.write_all(b"half")?).and(Err(anyhow::anyhow!("stop")))).is_err()
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }
}
