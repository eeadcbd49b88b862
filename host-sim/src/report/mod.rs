//! Reports: figures as JSON, and one self-contained page that opens offline.

pub mod closed_loop;
pub mod joints;
pub mod page;
pub mod plot;
