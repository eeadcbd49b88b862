//! Snapshots: readable files of measured figures, so that a change of a figure is a visible difference.

use crate::files::{at, write_whole};
use std::io;
use std::path::{Path, PathBuf};

/// Failure of a snapshot.
#[derive(Debug, thiserror::Error)]
pub enum SnapshotError {
    /// The file cannot be read or written.
    #[error(transparent)]
    File(#[from] io::Error),
    /// The figures are others.
    #[error("{path}:{line}: kept {kept:?}, measured {measured:?}")]
    Differs {
        /// The snapshot.
        path: PathBuf,
        /// First line that differs, from 1.
        line: usize,
        /// The line of the snapshot.
        kept: String,
        /// The line of the figures.
        measured: String,
    },
}

/// Writes `text` to the snapshot if `accept`, compares them otherwise.
///
/// Errors: [`SnapshotError`].
pub fn keep(path: &Path, text: &str, accept: bool) -> Result<(), SnapshotError> {
    if accept {
        return Ok(write_whole(path, text.as_bytes())?);
    }
    let kept = std::fs::read_to_string(path).map_err(|error| at(path, error))?;
    let count = kept.lines().count().max(text.lines().count());
    let lines = |text: &str, line: usize| text.lines().nth(line).unwrap_or_default().to_owned();
    for line in 0..count {
        let (kept, measured) = (lines(&kept, line), lines(text, line));
        if kept != measured {
            return Err(SnapshotError::Differs {
                path: path.to_owned(),
                line: line + 1,
                kept,
                measured,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_that_differs_is_named_until_it_is_accepted() {
        let path = std::env::temp_dir().join(format!("foretorque-snapshot-{}", std::process::id()));
        assert!(matches!(
            keep(&path, "", false),
            Err(SnapshotError::File(_))
        ));
        keep(&path, "a 1\nb 2\n", true).expect("writes");
        keep(&path, "a 1\nb 2\n", false).expect("equal");
        let differs = |text| keep(&path, text, false).expect_err("differs").to_string();
        assert!(differs("a 1\nb 3\n").ends_with(":2: kept \"b 2\", measured \"b 3\""));
        assert!(differs("a 1\n").ends_with(":2: kept \"b 2\", measured \"\""));
        keep(&path, "a 1\n", true).expect("writes");
        keep(&path, "a 1\n", false).expect("equal");
        std::fs::remove_file(path).expect("it was just written");
    }
}
