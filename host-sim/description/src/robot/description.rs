//! From a name or a file to a robot: the project's own description, an overlay, or a URDF.

use super::{Robot, RobotError, file, overlay};
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
        let import = Self::load_selected(name_or_path, &Selection::default())?;
        Ok(import.robot)
    }

    /// [`load`](Self::load) with the selection of a URDF's arm, and the notes of its reading.
    ///
    /// Errors: as there.
    pub fn load_selected(
        name_or_path: &str,
        selection: &Selection<'_>,
    ) -> Result<Import, RobotError> {
        if let Some((name, text)) = BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse_selected(name, text, selection);
        }
        let text = std::fs::read_to_string(Path::new(name_or_path)).map_err(|error| {
            RobotError::NotFound {
                name: name_or_path.to_owned(),
                known: Self::built_in().collect::<Vec<_>>().join(", "),
                reason: error.to_string(),
            }
        })?;
        Self::parse_selected(name_or_path, &text, selection)
    }

    /// A robot from the text of a description or of a URDF with a single arm; `file` is used in messages, and its directory
    /// for files that the text names.
    ///
    /// Errors: [`RobotError::Syntax`], [`RobotError::Field`], [`RobotError::Urdf`].
    pub fn parse(file: &str, text: &str) -> Result<Self, RobotError> {
        Ok(Self::parse_selected(file, text, &Selection::default())?.robot)
    }

    fn parse_selected(
        file: &str,
        text: &str,
        selection: &Selection<'_>,
    ) -> Result<Import, RobotError> {
        // TOML never begins with '<', XML always does.
        if text.trim_start().starts_with('<') {
            return urdf::parse(file, text, selection).map_err(|error| RobotError::Urdf {
                problem: error.to_string(),
            });
        }
        if let Some(import) = overlay::read(file, text, selection)? {
            return Ok(import);
        }
        if *selection != Selection::default() {
            return Err(RobotError::Urdf {
                problem: format!(
                    "{file}: --base, --tip, --weld, --repair and --link-mass are for a URDF"
                ),
            });
        }
        Ok(Import {
            robot: file::parse(file, text)?,
            notes: Vec::new(),
        })
    }
}
