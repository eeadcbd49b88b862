//! Files that are whole or absent: written beside their final name, renamed when complete.

use crate::Refusal;
use serde::de::DeserializeOwned;
use std::fs::{self, File};
use std::io::{self, BufWriter, Read, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Unfinished versions of this process.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Removes the unfinished versions of this process, then `end`s it; no other is begun meanwhile.
pub fn remove_unfinished(end: impl FnOnce()) {
    let parts = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
    for part in parts.iter() {
        // What cannot be removed is swept by the next run.
        let _ = fs::remove_file(part);
    }
    end();
}

/// Removes files of an earlier run from a directory of results.
///
/// Errors: the file system's, with the path in the message.
pub fn remove_stale(directory: &Path, names: &[&str]) -> io::Result<()> {
    for name in names {
        let path = directory.join(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(at(&path, error)),
            _ => {}
        }
    }
    Ok(())
}

/// Suffix of an unfinished version, before the number of its process.
const PART: &str = ".part";

/// The directory, or the current one where a path names none.
fn or_here(directory: &Path) -> &Path {
    match directory.as_os_str().is_empty() {
        true => Path::new("."),
        false => directory,
    }
}

/// Removes unfinished versions of `target` that killed runs have left: those that no process has locked.
fn sweep(target: &Path) {
    let (Some(name), Some(parent)) = (target.file_name(), target.parent()) else {
        return;
    };
    let Ok(entries) = fs::read_dir(or_here(parent)) else {
        return;
    };
    for entry in entries.flatten() {
        let number = entry.file_name();
        let number = number.as_encoded_bytes();
        let number = number.strip_prefix(name.as_encoded_bytes());
        let number = number.and_then(|rest| rest.strip_prefix(PART.as_bytes()));
        if !number.is_some_and(|digits| !digits.is_empty() && digits.iter().all(u8::is_ascii_digit))
        {
            continue;
        }
        if File::open(entry.path()).is_ok_and(|part| part.try_lock().is_ok()) {
            // What cannot be removed is left, as it was before.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// A file under construction. Dropped before [`WholeFile::finish`] it leaves nothing behind.
///
/// Devices and pipes are written as they are, links are followed, the mode of an earlier version is kept, and `-` is the
/// standard output.
#[derive(Debug)]
pub struct WholeFile {
    writer: BufWriter<File>,
    /// The unfinished version; none where the target is written as it is.
    part: Option<PathBuf>,
    target: PathBuf,
    /// Directories that were made for it, the innermost first.
    made: Vec<PathBuf>,
}

impl WholeFile {
    /// Opens the file's unfinished version, creating the directories above it.
    ///
    /// Errors: the file system's, with the path in the message.
    pub fn create(target: &Path) -> io::Result<Self> {
        let through = |file| Self {
            writer: BufWriter::new(file),
            part: None,
            target: target.to_owned(),
            made: Vec::new(),
        };
        if target == Path::new("-") {
            let stdout = io::stdout().as_fd().try_clone_to_owned();
            return stdout.map(|stdout| through(File::from(stdout)));
        }
        let before = fs::metadata(target).ok();
        let special = |before: &fs::Metadata| !before.is_file() && !before.is_dir();
        if before.as_ref().is_some_and(special) {
            let file = File::options().write(true).open(target);
            return file.map(through).map_err(|error| at(target, error));
        }
        let resolved = match before {
            Some(_) => fs::canonicalize(target).map_err(|error| at(target, error))?,
            None => target.to_owned(),
        };
        let target = &resolved;
        let above = target.ancestors().skip(1);
        let missing = above.take_while(|path| !path.as_os_str().is_empty() && !path.exists());
        let made: Vec<PathBuf> = missing.map(Path::to_owned).collect();
        if let Some(parent) = target.parent().filter(|p| !p.as_os_str().is_empty()) {
            let file = parent.ancestors().find(|path| path.is_file());
            if let Some(file) = file {
                let file = file.display();
                let problem = format!("{file} is a file: choose another directory");
                return Err(at(parent, io::Error::other(problem)));
            }
            fs::create_dir_all(parent).map_err(|error| at(parent, error))?;
        }
        sweep(target);
        let mut part = target.as_os_str().to_owned();
        // The process id keeps two runs that write the same file from sharing one unfinished version.
        part.push(format!("{PART}{}", std::process::id()));
        let part = PathBuf::from(part);
        // A signal that comes while the file is being made waits until it is on the list.
        let mut unfinished = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
        let file = loop {
            let file = File::create(&part).map_err(|error| at(target, error))?;
            // Where there are no locks, nothing is swept either.
            let _ = file.try_lock();
            // Another run may have swept it before it was locked.
            if part.exists() {
                break file;
            }
        };
        if let Some(before) = before.filter(fs::Metadata::is_file) {
            fs::set_permissions(&part, before.permissions()).map_err(|error| at(target, error))?;
        }
        unfinished.push(part.clone());
        Ok(Self {
            writer: BufWriter::new(file),
            part: Some(part),
            target: target.to_owned(),
            made,
        })
    }

    /// Gives the complete file its name.
    ///
    /// Errors: the file system's; the file's earlier version is then untouched.
    pub fn finish(mut self) -> io::Result<()> {
        self.flush()?;
        if let Some(part) = &self.part {
            // A name for bytes that a power cut loses would be an empty file.
            let kept = self.writer.get_ref().sync_all();
            let named = kept.and_then(|()| fs::rename(part, &self.target));
            named.map_err(|error| at(&self.target, error))?;
            sync_directory(&self.target);
        }
        Ok(())
    }
}

/// Makes the name of a file outlive a power cut. Where a directory cannot be opened or kept, the file itself is whole all the
/// same: under this name, or under that of its earlier version.
fn sync_directory(file: &Path) {
    let directory = File::open(or_here(file.parent().unwrap_or(Path::new(""))));
    let _ = directory.and_then(|directory| directory.sync_all());
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.writer.write(bytes);
        written.map_err(|error| at(&self.target, error))
    }

    fn flush(&mut self) -> io::Result<()> {
        let written = self.writer.flush();
        written.map_err(|error| at(&self.target, error))
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        // After a rename there is no unfinished version any more, and failing to remove one has no better remedy. A
        // directory that holds something, this file or another, stays.
        if let Some(part) = &self.part {
            let _ = fs::remove_file(part);
            let mut parts = UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner);
            parts.retain(|other| other != part);
        }
        for directory in &self.made {
            let _ = fs::remove_dir(directory);
        }
    }
}

/// Writes `contents` to `target` as a whole.
///
/// Errors: the file system's, with the path in the message.
pub fn write_whole(target: &Path, contents: &[u8]) -> io::Result<()> {
    let mut file = WholeFile::create(target)?;
    file.write_all(contents)?;
    file.finish()
}

/// Bytes of a text file from which it is refused: that of an arm or of settings has a few thousand.
const TOO_LONG: u64 = 64 << 20;

/// Text of a file of a description or of settings.
///
/// Errors: the file system's, without the path; a file of 64 MB and more, or a device without an end.
pub fn read_text(path: &Path) -> io::Result<String> {
    let text = io::read_to_string(File::open(path)?.take(TOO_LONG))?;
    if text.len() as u64 == TOO_LONG {
        let problem = "64 MB or more, far beyond any description or settings: name another file";
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, problem));
    }
    Ok(text)
}

/// Adds the path to a file-system error.
pub fn at(path: &Path, error: io::Error) -> io::Error {
    io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Text of a file of a description or of settings, as [`read_text`].
///
/// Errors: as there, with the path.
pub fn text_of(path: &Path) -> Result<String, Refusal> {
    read_text(path).map_err(|error| Refusal::of(path.display(), error))
}

/// A value in TOML.
///
/// Errors: the first complaint of the parser, with its line.
pub fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    toml::from_str(text).map_err(|error| toml_problem(text, &error))
}

/// The first complaint of the parser of `text`, with its line.
pub(crate) fn toml_problem(text: &str, error: &toml::de::Error) -> String {
    let before = error.span().and_then(|span| text.get(..span.start));
    let line = 1 + before.unwrap_or_default().matches('\n').count();
    let reason = error.message().lines().next().unwrap_or("not TOML");
    format!("line {line}: {reason}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use tempfile::tempdir;

    #[test]
    fn what_a_killed_run_left_is_swept_and_what_is_being_written_stays() {
        let here = tempdir().expect("creates");
        let names = ["log.csv.part1", "log.csv.part2", "log.csv.partial"];
        let [dead, alive, other] = names.map(|name| here.path().join(name));
        for file in [&dead, &other] {
            fs::write(file, b"half").expect("writes");
        }
        let running = File::create(&alive).expect("creates");
        running.lock().expect("locks");
        write_whole(&here.path().join("log.csv"), b"whole").expect("writes");
        assert!(!dead.exists() && alive.exists() && other.exists());
    }

    #[test]
    fn links_devices_and_modes_outlive_what_is_written_to_them() {
        use std::os::unix::fs::PermissionsExt;
        let here = tempdir().expect("creates");
        let [file, link, pipe, full] =
            ["file", "link", "pipe", "full"].map(|name| here.path().join(name));
        fs::write(&file, b"before").expect("writes");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).expect("sets");
        std::os::unix::fs::symlink(&file, &link).expect("links");
        write_whole(&link, b"after").expect("writes");
        assert!(fs::symlink_metadata(&link).expect("is there").is_symlink());
        let below = WholeFile::create(&file.join("report.json")).err();
        let below = below.expect("no directory").to_string();
        assert!(
            below.contains("is a file: choose another directory"),
            "{below}"
        );
        let mode = fs::metadata(&file).expect("is there").permissions().mode();
        assert_eq!(fs::read(&file).expect("reads"), b"after");
        assert_eq!(mode & 0o777, 0o600);
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).expect("makes");
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).expect("reads")
        });
        write_whole(&pipe, b"through").expect("writes");
        assert_eq!(reader.join().expect("ends"), b"through");
        std::os::unix::fs::symlink("/dev/full", &full).expect("links");
        let error = write_whole(&full, b"lost").expect_err("is full");
        let error = error.to_string();
        assert!(error.contains("full: No space left"), "{error}");
        remove_stale(here.path(), &["file", "nothing"]).expect("removes");
        assert!(!file.exists());
    }

    #[test]
    fn a_text_without_an_end_is_refused() {
        let here = tempdir().expect("creates");
        let large = here.path().join("large.toml");
        let file = File::create(&large).expect("creates");
        file.set_len(TOO_LONG).expect("it is sparse");
        for path in [&large, Path::new("/dev/zero")] {
            let name = path.display().to_string();
            let error = crate::robot::Robot::load(&name).expect_err("no description");
            let error = error.to_string();
            assert!(error.contains("as a file: 64 MB or more"), "{error}");
            assert!(error.contains(&name), "{error}");
        }
        file.set_len(20).expect("it is shorter");
        assert_eq!(read_text(&large).expect("reads").len(), 20);
    }

    #[test]
    fn an_unfinished_file_leaves_nothing_behind() {
        let here = tempdir().expect("creates");
        let directory = here.path().join("new");
        let target = directory.join("half.csv");
        let mut file = WholeFile::create(&target).expect("creates");
        file.write_all(b"half").expect("writes");
        drop(file);
        assert!(!directory.exists(), "it was made for the file");
        write_whole(&target, b"whole").expect("writes");
        assert_eq!(fs::read(&target).expect("reads"), b"whole");
        drop(WholeFile::create(&target).expect("creates"));
        assert_eq!(fs::read(&target).expect("reads"), b"whole");
    }
}
