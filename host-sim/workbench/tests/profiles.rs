//! Profiles shipped in host-sim/profiles: each reads, fits its drives, and its bus carries it.

use foretorque_workbench::bus::Profile;
use std::path::Path;

#[test]
fn shipped_profiles_are_sound() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../profiles");
    let mut names = Vec::new();
    for entry in folder.read_dir().unwrap() {
        let path = entry.unwrap().path();
        let profile = Profile::load(&path).unwrap();
        let name = path.file_stem().unwrap().display().to_string();
        for (place, joint) in profile.joint.iter().enumerate() {
            assert_eq!(joint.drive.check(), Ok(()), "{name}, joint {}", place + 1);
            let same = |other: &&_| {
                let other: &&foretorque_workbench::bus::JointEntry = other;
                other.bus == joint.bus && other.drive.id == joint.drive.id
            };
            assert_eq!(profile.joint.iter().filter(same).count(), 1, "{name}");
        }
        names.push(name);
    }
    for name in ["openarm", "yam", "piper-class", "moteus", "odrive"] {
        assert!(names.iter().any(|shipped| shipped == name), "{name}");
    }
}
