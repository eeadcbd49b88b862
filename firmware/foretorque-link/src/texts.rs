//! Enumerations with a text for each variant.

/// Declares an error. The text of a variant is its documentation and what it displays; names in braces are those of the
/// payload. A variant `of joint` has the number of a joint as payload, from 0, and displays it from 1.
macro_rules! errors {
    (
        $(#[$meta:meta])*
        pub enum $name:ident {
            $(
                $(#[$of:meta])*
                $variant:ident
                    $(of $joint:ident)?
                    $(($item:ident: $(#[$wire:meta])* $type:ty))?
                    $({ $(#[$inside:meta])* $field:ident: $number:ty })?
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
                    $(($(#[$wire])* $type))?
                    $({ $(#[$inside])* $field: $number })?,
            )*
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $(
                        Self::$variant $(($joint))? $(($item))? $({ $field })? => {
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
