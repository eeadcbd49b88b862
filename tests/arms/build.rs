//! Generates the module of every arm from its description, as `host-sim generate` does.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

use foretorque_description::generate::arm_module;
use foretorque_description::robot::Robot;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../data");
    let mut descriptions = vec![data.join("ur5_calibrated.toml")];
    for entry in fs::read_dir(data.join("pinocchio/arms"))? {
        descriptions.push(entry?.path());
    }
    descriptions.sort();
    println!("cargo::rerun-if-changed={}/pinocchio/arms", data.display());
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let mut modules = String::new();
    for description in &descriptions {
        println!("cargo::rerun-if-changed={}", description.display());
        let robot = Robot::load(&description.to_string_lossy())?;
        let file = out.join(&robot.name).with_extension("rs");
        fs::write(&file, arm_module(&robot))?;
        writeln!(modules, "#[path = {file:?}]\npub mod {};", robot.name)?;
    }
    fs::write(out.join("arms.rs"), modules)?;
    Ok(())
}
