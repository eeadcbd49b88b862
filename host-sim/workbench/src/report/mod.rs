//! Reports: figures as JSON, and one self-contained page that opens offline.

pub mod closed_loop;
pub mod ink;
pub mod joints;
mod markup;
pub mod page;
pub mod plot;
