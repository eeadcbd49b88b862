//! The committed header is the one that the source gives.

use std::fs;
use std::path::Path;

#[test]
fn the_header_is_that_of_the_source() {
    let place = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(place.join("cbindgen.toml")).expect("a configuration");
    let bindings = cbindgen::Builder::new()
        .with_config(config)
        .with_src(place.join("src/lib.rs"))
        .generate()
        .expect("the source has bindings");
    let mut generated = Vec::new();
    bindings.write(&mut generated);
    let generated = String::from_utf8(generated).expect("text");
    let header = place.join("include/foretorque.h");
    if std::env::var_os("UPDATE_HEADER").is_some() {
        fs::write(&header, &generated).expect("the header can be written");
    }
    let committed = fs::read_to_string(&header).expect("the header is there");
    assert!(
        committed == generated,
        "include/foretorque.h is not up to date: UPDATE_HEADER=1 cargo test -p foretorque-capi --test header"
    );
}
