//! Compiles GLSL to SPIR-V, at build time and, with the `hot-reload` feature, at run time.

use std::path::Path;

/// Prepended to every shader. Line numbers start after it.
const PRELUDE: &str = "\
#version 460
#extension GL_GOOGLE_include_directive : require
#include \"lib/prelude.glsl\"
#line 1
";

/// Compiles `glsl/{kernel}.{comp,vert,frag}`. `shared.glsl` is generated from `src/shared`; other includes are
/// files in the same folder.
///
/// The error is the compiler's log, with file names and lines.
pub fn compile(path: &Path) -> Result<Vec<u32>, String> {
    let read = |path: &Path| std::fs::read_to_string(path).map_err(|e| format!("cannot read {}: {e}", path.display()));
    let folder = path.parent().unwrap_or(Path::new("."));
    let kind = match path.extension().and_then(|e| e.to_str()) {
        Some("comp") => shaderc::ShaderKind::Compute,
        Some("vert") => shaderc::ShaderKind::Vertex,
        Some("frag") => shaderc::ShaderKind::Fragment,
        _ => return Err(format!("{}: not a shader", path.display())),
    };
    let kernel = path.file_stem().unwrap_or_default();
    let interface = crate::shared::interfaces().into_iter().find(|(name, _)| *name == kernel);
    let (_, interface) = interface.ok_or_else(|| format!("{}: no push struct is for it", path.display()))?;
    let shared = crate::shared::shared_glsl() + &interface;
    let compiler = shaderc::Compiler::new().map_err(|e| e.to_string())?;
    let mut options = shaderc::CompileOptions::new().map_err(|e| e.to_string())?;
    // SPIR-V 1.5: 1.6 has LocalSizeId, which needs maintenance4.
    options.set_target_env(shaderc::TargetEnv::Vulkan, shaderc::EnvVersion::Vulkan1_2 as u32);
    options.set_optimization_level(shaderc::OptimizationLevel::Performance);
    options.set_warnings_as_errors();
    options.set_include_callback(|name, _, _, _| {
        let content = if name == "shared.glsl" { Ok(shared.clone()) } else { read(&folder.join(name)) };
        content.map(|content| shaderc::ResolvedInclude { resolved_name: name.to_owned(), content })
    });
    compiler
        .compile_into_spirv(&(PRELUDE.to_owned() + &read(path)?), kind, &path.to_string_lossy(), "main", Some(&options))
        .map(|artifact| artifact.as_binary().to_vec())
        .map_err(|e| e.to_string())
}
