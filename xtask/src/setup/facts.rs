//! What the machine looks like, as far as planning needs it.

/// What a toolchain can do; all false when it is absent or broken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Kit {
    /// Compiles and links a small program for the board.
    pub(crate) target: bool,
    /// Has clippy.
    pub(crate) clippy: bool,
    /// Has rustfmt.
    pub(crate) rustfmt: bool,
}

/// Whether a means of getting things can still be tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Means {
    /// Not on this machine, or not allowed.
    Absent,
    /// Here and untried.
    Ready,
    /// Tried in this run; once is enough.
    Tried,
}

/// What the machine looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Facts {
    pub(crate) host: Kit,
    pub(crate) linked: Kit,
    /// `qemu-system-arm` knows the board's machine.
    pub(crate) emulator: bool,
    /// Debian's compiler, its sources, clippy and rustfmt are installed and new enough.
    pub(crate) debian_rust: bool,
    pub(crate) rustup: Means,
    pub(crate) apt: Means,
    /// Unpacking the emulator beside what is installed.
    pub(crate) unpack: Means,
    /// Building and linking a toolchain from Debian's packages; needs rustup to link it.
    pub(crate) build: Means,
}
