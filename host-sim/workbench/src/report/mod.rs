//! Reports: figures as JSON, and one self-contained page that opens offline. A plot is drawn in the colours of
//! a light page, which the style sheet of a page maps to those by meaning.

pub mod closed_loop;
pub mod page;
pub mod plot;

use crate::files::{WholeFile, write_whole};
use page::Page;
use plotters::style::RGBColor;
use serde::Serialize;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A report under construction. Dropped before [`finish`](Self::finish) it leaves nothing behind.
pub struct ReportFiles {
    json: WholeFile,
    page: PathBuf,
}

impl ReportFiles {
    /// The report in the directory `out`.
    ///
    /// Errors: a directory that cannot be written.
    pub fn create(out: &Path) -> io::Result<Self> {
        Ok(Self {
            json: WholeFile::create(&out.join("report.json"))?,
            page: out.join("report.html"),
        })
    }

    /// Writes both files; returns the path of the page.
    ///
    /// Errors: the file system's, figures that JSON cannot hold, the plot library's.
    pub fn finish(mut self, report: &impl Serialize, page: &Page) -> io::Result<PathBuf> {
        put_json(&mut self.json, report)?;
        write_whole(&self.page, page.html()?.as_bytes())?;
        self.json.finish()?;
        Ok(self.page)
    }
}

/// Writes figures as JSON.
///
/// Errors: the file's.
pub fn write_json(path: &Path, figures: &impl Serialize) -> io::Result<()> {
    let mut file = WholeFile::create(path)?;
    put_json(&mut file, figures)?;
    file.finish()
}

/// Puts figures into a file as JSON.
///
/// Errors: the file's, figures that JSON cannot hold.
pub fn put_json(mut file: impl Write, figures: &(impl Serialize + ?Sized)) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut file, figures)?;
    file.write_all(b"\n")
}

/// Text made safe for HTML and SVG.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Colour of a curve, by meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlotColor {
    /// True or desired value.
    Truth,
    /// The starting model, wrong on purpose.
    Before,
    /// The learnt model.
    After,
    /// A fourth curve.
    Other,
    /// One of up to eight joints, from 0.
    Joint(u8),
}

impl PlotColor {
    /// Name of the page's CSS variable for this colour.
    pub(super) fn variable(self) -> String {
        match self {
            Self::Truth => "--truth".to_owned(),
            Self::Before => "--before".to_owned(),
            Self::After => "--after".to_owned(),
            Self::Other => "--other".to_owned(),
            Self::Joint(joint) => format!("--joint{}", joint % 8 + 1),
        }
    }
}

/// Name, light and dark of every colour of a page.
const PALETTE: [(&str, &str, &str); 19] = [
    ("--page", "#fbfbfa", "#101418"),
    ("--card", "#ffffff", "#171c22"),
    ("--text", "#1f2328", "#e6e9ed"),
    ("--quiet", "#59636e", "#9aa4af"),
    ("--axis", "#8c959f", "#6b7580"),
    ("--grid", "#e6e8eb", "#2a313a"),
    ("--line", "#d8dce1", "#2f3741"),
    ("--truth", "#a3abb5", "#7d8894"),
    ("--before", "#d9660a", "#ff9a3d"),
    ("--after", "#0b5fd6", "#6aa9ff"),
    ("--other", "#12805c", "#3ecf9a"),
    ("--joint1", "#0b5fd6", "#6aa9ff"),
    ("--joint2", "#d9660a", "#ff9a3d"),
    ("--joint3", "#12805c", "#3ecf9a"),
    ("--joint4", "#b4267a", "#f472b6"),
    ("--joint5", "#6b46c9", "#b39bff"),
    ("--joint6", "#8a6d00", "#e0c04a"),
    ("--joint7", "#0e7c93", "#4fd1e8"),
    ("--joint8", "#7a4a2b", "#d9a27e"),
];

/// The light colour of a variable.
pub(super) fn light(variable: &str) -> &'static str {
    let known = PALETTE.iter().find(|(name, _, _)| *name == variable);
    known.map_or("#000", |(_, light, _)| light)
}

/// CSS that defines the colours, light and dark.
pub(super) fn variables() -> String {
    let (mut lights, mut darks) = (String::new(), String::new());
    for (name, light, dark) in PALETTE {
        lights += &format!("{name}:{light};");
        darks += &format!("{name}:{dark};");
    }
    format!(":root{{{lights}}}\n@media (prefers-color-scheme:dark){{:root{{{darks}}}}}\n")
}

/// The light colour of a variable, as a drawing has it.
pub(super) fn rgb(variable: &str) -> RGBColor {
    let code = u32::from_str_radix(&light(variable)[1..], 16).unwrap_or(0);
    let [_, red, green, blue] = code.to_be_bytes();
    RGBColor(red, green, blue)
}

/// CSS rules that map the colours of a drawing to their variables.
pub(super) fn style_sheet() -> String {
    let rule = |(name, light, _): (&str, &str, &str)| {
        let hex = light.to_uppercase();
        format!(
            "svg [stroke=\"{hex}\"]{{stroke:var({name})}}svg [fill=\"{hex}\"]{{fill:var({name})}}\n"
        )
    };
    PALETTE.into_iter().map(rule).collect()
}
