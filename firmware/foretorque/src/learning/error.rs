/// Invalid field of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ConfigError {
    /// The field is not a positive, finite number.
    NotPositive(&'static str),
    /// The field lies outside `0..1`.
    RateOutOfRange(&'static str),
}

impl core::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotPositive(field) => write!(f, "{field} must be positive and finite"),
            Self::RateOutOfRange(field) => write!(f, "{field} must lie between 0 and 1"),
        }
    }
}

impl core::error::Error for ConfigError {}

/// Check of named fields; the first one that is not positive and finite is the error.
pub(super) fn check_positive(
    fields: impl IntoIterator<Item = (&'static str, f32)>,
) -> Result<(), ConfigError> {
    for (field, value) in fields {
        if !(value > 0.0 && value.is_finite()) {
            return Err(ConfigError::NotPositive(field));
        }
    }
    Ok(())
}
