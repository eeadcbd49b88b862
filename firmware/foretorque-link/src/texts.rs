//! Enumerations with a text for each variant.

/// Declares an error. The text of a variant is its documentation and what it displays; names in braces are those of the
/// payload. A variant `of joint` has the number of a joint as payload, from 0, and displays it from 1. A payload of 0 may
/// have a text of its own.
macro_rules! errors {
    (
        $(#[$meta:meta])*
        pub enum $name:ident {
            $(
                $(#[$of:meta])*
                $variant:ident
                    $(of $joint:ident)?
                    $(($($item:ident: $(#[$wire:meta])* $type:ty),+))?
                    $({ $(#[$inside:meta])* $field:ident: $number:ident $(; 0 = $none:literal)? })?
                    = $text:literal;
            )*
        }
    ) => {
        $(#[$meta])*
        pub enum $name {
            $(
                #[doc = $text]
                $(#[$of])*
                $variant
                    $((errors!(@number $joint)))?
                    $(($($(#[$wire])* $type),+))?
                    $({ $(#[$inside])* $field: $number })?,
            )*
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $(
                        $($(Self::$variant { $field: 0 } => f.write_str($none),)?)?
                        Self::$variant $(($joint))? $(($($item),+))? $({ $field })? => {
                            $(let $joint = u16::from(*$joint) + 1;)?
                            write!(f, $text)
                        }
                    )*
                }
            }
        }

        impl core::error::Error for $name {}
    };
    (@number $joint:ident) => { u8 };
}

/// Declares an error whose description goes to a defmt log without the payload. What a variant displays besides stands
/// behind its description, with the name of the payload in braces.
macro_rules! described_errors {
    (
        $(#[$meta:meta])*
        pub enum $name:ident {
            $(
                $(#[$of:meta])*
                $variant:ident $(($item:ident: $type:ty))? = $text:literal $(, $more:literal)?;
            )*
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $(
                #[doc = $text]
                $(#[$of])*
                $variant $(($type))?,
            )*
        }

        #[cfg(feature = "defmt")]
        impl $name {
            /// Description without the payload, for a log.
            pub fn interned(self) -> defmt::Str {
                match self {
                    $(Self::$variant { .. } => defmt::intern!($text),)*
                }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $(Self::$variant $(($item))? => {
                        f.write_str($text)?;
                        $(write!(f, $more)?;)?
                    })*
                }
                Ok(())
            }
        }

        impl core::error::Error for $name {}
    };
}
