#!/usr/bin/env bash
# Brings what rustup cannot, on Debian and its relatives. `cargo xtask setup` calls it, one at a time.
#
#   debian.sh packages NAME...                    installs packages
#   debian.sh emulator HOME                       installs qemu-system-arm, or unpacks it into HOME/emulator
#   debian.sh toolchain HOME NAME TARGET OLDEST   builds core for TARGET from the packaged compiler, of version OLDEST or
#                                                 newer, into HOME/NAME and links that as the rustup toolchain NAME
set -euo pipefail

# Waits for other installers and slow archives, but not without end.
bounded=(-qq -o DPkg::Lock::Timeout=120 -o Acquire::Retries=2 -o Acquire::http::Timeout=30)
# Never the compiler of the same name that rustup puts before it on the path.
debian_rustc=/usr/bin/rustc

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif sudo -n true 2>/dev/null; then
        sudo -n "$@"
    else
        echo "set-up: this needs root, and \`sudo -n\` does not give it" >&2
        return 1
    fi
}

refresh() {
    # An earlier run may have ended in the middle of dpkg; on a sound machine this does nothing.
    as_root dpkg --configure -a || return
    as_root apt-get update "${bounded[@]}" || echo "set-up: apt-get update failed; the package lists already here are used"
}

# Nothing that is installed is removed: Debian's two Rust compilers exclude each other.
packages() {
    echo "set-up: apt-get install $*"
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends --no-remove \
        "${bounded[@]}" -o Dpkg::Use-Pty=0 "$@"
}

# Without root, or where installing would remove a package, the emulator and the libraries that are not installed are
# unpacked into HOME/emulator. A script beside cargo's programs, which are on the path of all that cargo runs, starts it.
unpack_emulator() {
    local place=$1/emulator bin=${CARGO_HOME:-$HOME/.cargo}/bin archive directory libraries=
    mkdir -p "$stage/archives/partial"
    # A download changes nothing that is installed: it may plan a removal, and needs neither root nor a lock.
    apt-get install --download-only --yes --no-install-recommends "${bounded[@]}" -o Debug::NoLocking=1 \
        -o "Dir::Cache::archives=$stage/archives" qemu-system-arm
    for archive in "$stage"/archives/*.deb; do
        dpkg-deb -x "$archive" "$stage/unpacked"
    done
    for directory in "$stage"/unpacked/usr/lib/*-linux-* "$stage"/unpacked/lib/*-linux-*; do
        libraries+=${libraries:+:}$place${directory#"$stage/unpacked"}
    done
    {
        echo '#!/bin/sh'
        echo '# Written by `cargo xtask setup` of foretorque: the emulator could not be installed as a package.'
        printf 'LD_LIBRARY_PATH=%q${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} exec %q "$@"\n' \
            "$libraries" "$place/usr/bin/qemu-system-arm"
    } >"$stage/start"
    chmod +x "$stage/start"
    rm -rf "$place"
    mv "$stage/unpacked" "$place"
    "$stage/start" --version
    mv "$stage/start" "$bin/qemu-system-arm"
}

# Compiler, sources, clippy and rustfmt under the first of Debian's two names whose version suffices. A stable release
# carries the newer compiler for its browsers.
rust_packages() {
    local oldest=$1 suffix candidate
    for suffix in -web ""; do
        candidate=$(apt-cache policy "rustc$suffix" | sed -n 's/^ *Candidate: //p')
        if dpkg --compare-versions "${candidate:-(none)}" ge "$oldest" 2>/dev/null; then
            case $suffix in
            -web) echo rustc-web rust-web-src rust-web-clippy rustfmt-web ;;
            *) echo rustc rust-src rust-clippy rustfmt ;;
            esac
            return
        fi
    done
    echo "set-up: this Debian has no Rust compiler of version $oldest or newer" >&2
    return 1
}

# Packages that are here already need no root.
rust_is_here() {
    local oldest=$1
    [ -x /usr/bin/cargo-clippy ] && [ -x /usr/bin/cargo-fmt ] && [ -x /usr/bin/rustfmt ] && [ -x $debian_rustc ] &&
        [ -d "$($debian_rustc --print sysroot)/lib/rustlib/src/rust/library/core" ] &&
        dpkg --compare-versions "$($debian_rustc --version | cut -d ' ' -f 2)" ge "$oldest"
}

toolchain() {
    local name=$2 target=$3 oldest=$4 place=$1/$2 new=$stage/toolchain host crate tool names
    if ! rust_is_here "$oldest"; then
        refresh
        names=$(rust_packages "$oldest")
        # shellcheck disable=SC2086 # Four words.
        packages $names
    fi

    # The unstable flags need a nightly or a bootstrapping compiler. Fat link-time optimisation later reads the bitcode,
    # which cargo leaves out by default.
    mkdir -p "$stage/empty/src"
    printf '#![no_std]\n' >"$stage/empty/src/lib.rs"
    printf '[package]\nname = "empty"\nedition = "2024"\n[workspace]\n[profile.release]\npanic = "abort"\n' \
        >"$stage/empty/Cargo.toml"
    (cd "$stage/empty" && env -u CARGO_ENCODED_RUSTFLAGS RUSTC=$debian_rustc RUSTC_BOOTSTRAP=1 \
        RUSTFLAGS="-C embed-bitcode=yes" cargo build --quiet --release -Zbuild-std=core,alloc --target "$target" \
        --target-dir "$stage/target")

    mkdir -p "$new/bin" "$new/lib/rustlib/$target/lib"
    for crate in core alloc compiler_builtins; do
        cp "$stage/target/$target/release/deps/lib$crate"-*.rlib "$new/lib/rustlib/$target/lib/"
    done
    # Build scripts and procedural macros run on the host, with Debian's own libraries. The linker for the board is
    # rustup's rust-lld, which rustc expects beside them.
    host=$($debian_rustc -vV | sed -n 's/^host: //p')
    mkdir "$new/lib/rustlib/$host"
    ln -s "$($debian_rustc --print sysroot)/lib/rustlib/$host/lib" "$new/lib/rustlib/$host/lib"
    ln -s "$(rustc --print sysroot)/lib/rustlib/$host/bin" "$new/lib/rustlib/$host/bin"
    # Without a cargo of its own rustup would lend it that of any toolchain, nightly first.
    ln -s "$(rustup which cargo)" "$new/bin/cargo"
    for tool in cargo-fmt rustfmt; do
        ln -s "/usr/bin/$tool" "$new/bin/$tool"
    done
    printf '#!/bin/sh\nexec %s --sysroot %q "$@"\n' "$debian_rustc" "$place" >"$new/bin/rustc"
    printf '#!/bin/sh\nSYSROOT=%q exec /usr/bin/cargo-clippy "$@"\n' "$place" >"$new/bin/cargo-clippy"
    chmod +x "$new/bin/rustc" "$new/bin/cargo-clippy"
    rm -rf "$place"
    mv "$new" "$place"
    rustup toolchain link "$name" "$place"
}

task=$1
shift
case $task in
packages)
    refresh
    packages "$@"
    ;;
emulator | toolchain)
    # Made beside the final place and renamed at the end: an interrupted run leaves nothing, or what was there.
    stage=$1/.stage
    rm -rf "$stage"
    mkdir -p "$stage"
    trap 'rm -rf "$stage"' EXIT
    if [ "$task" = toolchain ]; then
        toolchain "$@"
    elif ! { refresh && packages qemu-system-arm; }; then
        unpack_emulator "$@"
    fi
    ;;
*)
    echo "debian.sh: unknown task $task" >&2
    exit 2
    ;;
esac
