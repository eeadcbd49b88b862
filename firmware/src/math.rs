//! f32 kernels of the tick, each with its error bound and cost.
