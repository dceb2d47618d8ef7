//! Compiles every kernel in `glsl/` to SPIR-V in `OUT_DIR`, with `shared.glsl` generated from `src/shared`.

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
    let shared = shared::shared_glsl();
    let mut kernels: Vec<_> = std::fs::read_dir("glsl").expect("glsl/ is beside build.rs").flatten().collect();
    kernels.retain(|entry| entry.path().is_file());
    for kernel in kernels {
        let path = kernel.path();
        let spirv = compile::compile(&path, &shared).unwrap_or_else(|log| panic!("{log}"));
        let name = path.file_name().expect("it is a file").to_string_lossy().into_owned();
        let bytes: Vec<u8> = spirv.into_iter().flat_map(u32::to_ne_bytes).collect();
        std::fs::write(Path::new(&out).join(name + ".spv"), bytes).expect("OUT_DIR is writable");
    }
}
