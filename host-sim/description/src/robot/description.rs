//! From a name or a file to a robot: the project's own description or a URDF. Only this file
//! imports both formats.

use super::{Robot, RobotError, file};
use crate::urdf::{self, Import, Selection};
use std::path::Path;

/// Descriptions that need no file, by name.
const BUILT_IN: [(&str, &str); 2] = [
    ("ur5", include_str!("../../../robots/ur5.toml")),
    ("panda", include_str!("../../../robots/panda.urdf")),
];

impl Robot {
    /// Names of the robots that need no file.
    pub fn built_in() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// A built-in robot by name, or a description or URDF file by path.
    ///
    /// Errors: [`RobotError`], naming the file and the field.
    ///
    /// ```
    /// let ur5 = foretorque_description::robot::Robot::load("ur5").unwrap();
    /// assert_eq!(ur5.joints.len(), 6);
    /// ```
    pub fn load(name_or_path: &str) -> Result<Self, RobotError> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse(name, text);
        }
        let text = std::fs::read_to_string(Path::new(name_or_path)).map_err(|error| {
            RobotError::NotFound {
                name: name_or_path.to_owned(),
                known: Self::built_in().collect::<Vec<_>>().join(", "),
                reason: error.to_string(),
            }
        })?;
        Self::parse(name_or_path, &text)
    }

    /// [`load`](Self::load) with the selection of a URDF's arm, and the notes of its reading.
    ///
    /// Errors: as there.
    pub fn load_selected(
        name_or_path: &str,
        selection: &Selection<'_>,
    ) -> Result<Import, RobotError> {
        let built_in = Self::built_in().any(|name| name == name_or_path);
        let text = std::fs::read_to_string(name_or_path).unwrap_or_default();
        if built_in || !text.trim_start().starts_with('<') {
            let robot = Self::load(name_or_path)?;
            if *selection != Selection::default() {
                return Err(RobotError::Urdf {
                    problem: format!(
                        "{name_or_path}: --base, --tip, --weld, --repair and --link-mass are for a URDF"
                    ),
                });
            }
            return Ok(Import {
                robot,
                notes: Vec::new(),
            });
        }
        urdf::parse(name_or_path, &text, selection).map_err(|error| RobotError::Urdf {
            problem: error.to_string(),
        })
    }

    /// A robot from the text of a description or of a URDF with a single arm; `file` is only used in messages.
    ///
    /// Errors: [`RobotError::Syntax`], [`RobotError::Field`], [`RobotError::Urdf`].
    pub fn parse(file: &str, text: &str) -> Result<Self, RobotError> {
        // TOML never begins with '<', XML always does.
        if text.trim_start().starts_with('<') {
            let import = urdf::parse(file, text, &Selection::default());
            return import
                .map(|arm| arm.robot)
                .map_err(|error| RobotError::Urdf {
                    problem: error.to_string(),
                });
        }
        file::parse(file, text)
    }
}
