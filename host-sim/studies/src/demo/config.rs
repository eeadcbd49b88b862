//! Size of the main job.

/// Points of curves that the page shows.
pub(super) const PAGE_POINTS: usize = 3000;

/// Size of the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DemoConfig {
    /// Seed of plant, prior, paths and noise.
    pub seed: u64,
    /// Period of the tick, s.
    pub period_s: f64,
    /// Arm time with learning on, long run, s.
    pub learning_s: f64,
    /// Arm time with learning on, flashable firmware, s.
    pub usart_learning_s: f64,
    /// Length of the unseen path that is played, s.
    pub validation_s: f64,
    /// Bandwidth of the PD controller, Hz.
    pub pd_bandwidth_hz: f64,
    /// Random candidates of the excitation.
    pub excitation_candidates: usize,
}

impl Default for DemoConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            period_s: 1e-3,
            learning_s: 80.0,
            usart_learning_s: 5.0,
            validation_s: 30.0,
            pd_bandwidth_hz: 6.0,
            excitation_candidates: 100,
        }
    }
}

impl DemoConfig {
    /// Number of ticks in `duration_s`.
    pub(super) fn ticks(&self, duration_s: f64) -> usize {
        (duration_s / self.period_s).round() as usize
    }
}
