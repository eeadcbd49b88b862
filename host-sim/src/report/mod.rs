//! Reports: figures as JSON, and one self-contained page that opens offline.

pub mod page;
pub mod plot;
