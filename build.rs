//! Compiles every kernel in `glsl/` to SPIR-V in `OUT_DIR`, with `shared.glsl` generated from `src/shared`, and lists
//! them.

#[path = "src/gpu/compile.rs"]
mod compile;
#[path = "src/shared/mod.rs"]
mod shared;

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=glsl");
    println!("cargo:rerun-if-changed=src/gpu/compile.rs");
    println!("cargo:rerun-if-changed=src/shared");

    let out = std::env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let out = Path::new(&out);
    let files = std::fs::read_dir("glsl").expect("glsl/ is beside build.rs").flatten();
    let mut kernels: Vec<_> = files.map(|file| file.path()).filter(|path| path.is_file()).collect();
    kernels.sort();
    let mut list = String::new();
    for path in kernels {
        let spirv = compile::compile(&path).unwrap_or_else(|log| panic!("{log}"));
        let name = path.file_name().expect("it is a file").to_string_lossy();
        let bytes: Vec<u8> = spirv.into_iter().flat_map(u32::to_ne_bytes).collect();
        std::fs::write(out.join(format!("{name}.spv")), bytes).expect("OUT_DIR is writable");
        list += &format!("({name:?}, include_bytes!(\"{name}.spv\")),\n");
    }
    std::fs::write(out.join("spirv.rs"), format!("&[\n{list}]\n")).expect("OUT_DIR is writable");
}
