//! Universal Robots UR5 (CB series).
