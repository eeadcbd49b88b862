//! The emulator unpacked into a directory of its own, where packages cannot be installed: without root, or where
//! installing one would remove another (an emulator's tools of a newer release, say).

use std::fs;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::{env, process};

use anyhow::{Context as _, Result, ensure};

use super::debian;
use crate::shell::{capture, command, run};

/// The package, and the program in it.
pub(crate) const PACKAGE: &str = "qemu-system-arm";

/// Whether the two programs this way needs are here.
pub(crate) fn possible() -> bool {
    ["apt-get", "dpkg-deb"]
        .iter()
        .all(|program| capture(command(program).arg("--version")).is_some())
}

/// Fetches the emulator with every library that is not installed, unpacks them under `home`, and puts a script that starts
/// it beside cargo's own programs, where everything that cargo runs finds it.
///
/// Unpacked and tried beside the final place, then renamed: an interrupted run leaves none, or the old one. The caller
/// holds the lock on `home`.
pub(crate) fn emulator(home: &Path) -> Result<()> {
    let stage = home.join(format!(".unpacking-{}", process::id()));
    let outcome = unpack(&stage).and_then(|()| settle(&stage, &home.join("emulator")));
    let _ = fs::remove_dir_all(&stage);
    outcome
}

fn unpack(stage: &Path) -> Result<()> {
    let archives = stage.join("archives");
    fs::create_dir_all(archives.join("partial"))
        .with_context(|| format!("cannot write {}", archives.display()))?;
    // Downloading changes nothing that is installed, so it may plan a removal, and needs neither root nor a lock.
    run(command("apt-get")
        .args([
            "install",
            "--download-only",
            "--yes",
            "--no-install-recommends",
        ])
        .args(debian::PATIENCE)
        .args(["-o", "Debug::NoLocking=1", "-o"])
        .arg(format!("Dir::Cache::archives={}", archives.display()))
        .arg(PACKAGE))?;
    let root = stage.join("root");
    let mut unpacked = 0;
    for entry in fs::read_dir(&archives)? {
        let path = entry?.path();
        if path.extension().is_some_and(|end| end == "deb") {
            run(command("dpkg-deb").arg("-x").args([&path, &root]))?;
            unpacked += 1;
        }
    }
    ensure!(unpacked > 0, "no package was fetched");
    Ok(())
}

/// Tries what was unpacked, moves it to its place and writes the script.
fn settle(stage: &Path, place: &Path) -> Result<()> {
    let trial = stage.join(PACKAGE);
    write_script(&trial, &stage.join("root"))?;
    let trial = trial.to_str().context("the home's path is not UTF-8")?;
    run(command(trial).arg("--version"))?;
    if place.exists() {
        fs::remove_dir_all(place)?;
    }
    fs::rename(stage.join("root"), place)
        .with_context(|| format!("cannot move the emulator to {}", place.display()))?;
    let bin = cargo_home()?.join("bin");
    let ready = bin.join(format!(".{PACKAGE}-{}", process::id()));
    write_script(&ready, place)?;
    fs::rename(&ready, bin.join(PACKAGE))
        .with_context(|| format!("cannot write {}/{PACKAGE}", bin.display()))
}

/// Where cargo's programs are: rustup puts it first on the path of all it starts.
fn cargo_home() -> Result<PathBuf> {
    match env::var_os("CARGO_HOME") {
        Some(path) => Ok(path.into()),
        None => Ok(env::home_dir()
            .context("there is no home directory")?
            .join(".cargo")),
    }
}

fn write_script(path: &Path, root: &Path) -> Result<()> {
    let mut libraries = Vec::new();
    for above in ["usr/lib", "lib"] {
        let Ok(entries) = fs::read_dir(root.join(above)) else {
            continue;
        };
        for entry in entries {
            let entry = entry?;
            if entry.file_name().to_string_lossy().contains("-linux-") {
                libraries.push(entry.path());
            }
        }
    }
    let libraries = env::join_paths(&libraries).context("a path with a colon")?;
    let libraries = debian::quoted(Path::new(&libraries))?;
    let program = debian::quoted(&root.join("usr/bin").join(PACKAGE))?;
    let mut file = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o755)
        .open(path)
        .with_context(|| format!("cannot write {}", path.display()))?;
    writeln!(
        file,
        "#!/bin/sh\n# Written by `cargo xtask setup` of foretorque: the emulator could not be installed as a package.\n\
         LD_LIBRARY_PATH={libraries}${{LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}} exec {program} \"$@\""
    )?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_runs_the_unpacked_program_with_its_own_libraries() {
        let home = env::temp_dir().join(format!("foretorque-unpacked-{}", process::id()));
        let root = home.join("a place");
        for above in [
            "usr/bin",
            "usr/lib/some-linux-gnu",
            "lib/some-linux-gnu",
            "lib/udev",
        ] {
            fs::create_dir_all(root.join(above)).unwrap();
        }
        let program = root.join("usr/bin").join(PACKAGE);
        fs::write(&program, "#!/bin/sh\necho \"$LD_LIBRARY_PATH|$1\"\n").unwrap();
        run(command("chmod").arg("+x").arg(&program)).unwrap();
        let script = home.join("script");
        write_script(&script, &root).unwrap();
        let said = capture(
            command(script.to_str().unwrap())
                .env_remove("LD_LIBRARY_PATH")
                .arg("two words"),
        );
        let at = |end: &str| root.join(end).display().to_string();
        let expected = format!(
            "{}:{}|two words\n",
            at("usr/lib/some-linux-gnu"),
            at("lib/some-linux-gnu")
        );
        assert_eq!(said.as_deref(), Some(expected.as_str()));
        fs::remove_dir_all(&home).unwrap();
    }
}
