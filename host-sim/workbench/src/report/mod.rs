//! Reports: figures as JSON, and one self-contained page that opens offline.

pub mod closed_loop;
mod color;
mod files;
pub mod page;
pub mod plot;

pub use files::{ReportError, ReportFiles};

/// Text made safe for HTML and SVG.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
