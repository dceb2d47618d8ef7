//! Every Vulkan call that can fail does, early and late: one clear error, nothing half-written, nothing left behind
//! that the validation layer sees.

mod command;
mod desktop;

use std::path::Path;

use command::{Run, relume};
use desktop::Desktop;
use desktop::pictures::scene;

/// Calls of every picture; below, those of shadow maps, which are drawn on the device.
const CALLS: [&str; 22] = [
    "vkCreateDescriptorSetLayout",
    "vkCreatePipelineLayout",
    "vkCreatePipelineCache",
    "vkCreateCommandPool",
    "vkAllocateCommandBuffers",
    "vkCreateFence",
    "vkCreateQueryPool",
    "vkCreateShaderModule",
    "vkCreateComputePipelines",
    "vkCreateBuffer",
    "vkAllocateMemory",
    "vkMapMemory",
    "vkBindBufferMemory",
    "vkResetCommandPool",
    "vkBeginCommandBuffer",
    "vkEndCommandBuffer",
    "vkQueueSubmit2",
    "vkWaitForFences",
    "vkResetFences",
    "vkGetQueryPoolResults",
    "vkGetPipelineCacheData",
    "vkDeviceWaitIdle",
];
const MAP_CALLS: [&str; 8] = [
    "vkCreateImage",
    "vkBindImageMemory",
    "vkCreateImageView",
    "vkCreateSampler",
    "vkCreateGraphicsPipelines",
    "vkCreateDescriptorPool",
    "vkAllocateDescriptorSets",
    "vkQueueSubmit2",
];

/// What such a call fails with where it does.
fn result(call: &str) -> &'static str {
    let loses_device =
        ["vkQueueSubmit2", "vkWaitForFences", "vkGetQueryPoolResults", "vkDeviceWaitIdle", "vkAcquireNextImageKHR"];
    match call {
        _ if loses_device.contains(&call) => "device-lost",
        "vkAllocateMemory" | "vkCreateBuffer" | "vkCreateImage" => "out-of-device-memory",
        _ => "out-of-host-memory",
    }
}

/// A picture of two lights, of which one is dim; `fault` is in the environment.
fn render(output: &Path, visibility: &str, fault: &str) -> Run {
    let mut command = relume();
    command.arg("render").arg(scene("balls-2.glb")).arg("-o").arg(output).env("RELUME_FAULT", fault);
    // Faults are those of one device: the others are not measured.
    command.args(["--device", "0"]);
    command.args(["--size", "64x48", "--gi", "glossy", "--gather", "64", "--rays", "16", "--visibility", visibility]);
    command.env("VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation");
    command.env("VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT");
    objects_to_nothing(Run::of(&mut command))
}

/// The validation layer speaks on standard output, of what was left behind, too.
fn objects_to_nothing(run: Run) -> Run {
    assert_eq!(run.stdout, "", "{}", run.stderr);
    run
}

/// Makes calls of each kind fail from the first on, from the second, the fourth and so forth until none is left to
/// fail.
fn fails_cleanly(calls: &[&str], visibility: &str) {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("picture.png");
    render(&output, visibility, "vkQueueSubmit2:1000000:device-lost").done();
    let clean = std::fs::read(&output).unwrap();
    for call in calls {
        let mut failed = 0;
        for first in (0..).map(|i| 1 << i) {
            std::fs::remove_file(&output).unwrap();
            let run = render(&output, visibility, &format!("{call}:{first}:{}", result(call)));
            if run.code == Some(0) {
                assert_eq!(run.stderr, "", "{call}");
                assert_eq!(std::fs::read(&output).unwrap(), clean, "{call}");
                break;
            }
            run.failed(match result(call) {
                "device-lost" => &["Vulkan could not", "the device was lost", "--device"],
                "out-of-device-memory" => &["Vulkan could not", "the device is out of memory", "--size"],
                _ => &["Vulkan could not"],
            });
            assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "{call} leaves something");
            std::fs::write(&output, "").unwrap();
            failed += 1;
        }
        // A picture without these is a picture.
        let is_needed = !["vkGetPipelineCacheData", "vkDeviceWaitIdle"].contains(call);
        assert_eq!(failed > 0, is_needed, "{call} fails {failed} times");
    }
}

#[test]
fn calls_of_every_picture() {
    fails_cleanly(&CALLS, "traced");
}

#[test]
fn calls_of_shadow_maps() {
    fails_cleanly(&MAP_CALLS, "map");
}

#[test]
fn a_fault_that_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let calls = ["", "vkQueueSubmit2", "vkFoo:1:device-lost"];
    let counts = ["vkQueueSubmit2:x:device-lost", "vkQueueSubmit2:0:device-lost"];
    let results = ["vkQueueSubmit2:1:tired", "vkQueueSubmit2:1:device-lost:1"];
    for fault in [&calls[..], &counts, &results].concat() {
        render(&folder.path().join("picture.png"), "traced", fault).failed(&["RELUME_FAULT"]);
    }
}

/// Calls of a window, and a device that is lost while lights are edited: edits are kept beside the rig.
#[test]
fn calls_of_a_window() {
    let Some(desktop) = Desktop::start() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (rig, script) = (folder.path().join("rig.toml"), folder.path().join("edits.script"));
    let kept = rig.with_extension("autosave.toml");
    let scene = scene("balls-2.glb");
    Run::of(relume().arg("rig").arg(&scene).arg("-o").arg(&rig)).done();
    // A window that nothing happens to would stay.
    let edits: String = (1..60).map(|i| format!("{:.1} key D\n", 0.2 * f64::from(i))).collect();
    std::fs::write(&script, edits + "12.5 key Ctrl+Q\n13.0 key Q\n").unwrap();
    let [rig_text, scene, script] = [&rig, &scene, &script].map(|path| path.to_str().unwrap());
    let arguments = ["view", scene, "--device", "0", "--rig", rig_text, "--size", "96x64", "--script", script];
    for (call, first) in [
        ("vkCreateSwapchainKHR", 1),
        ("vkGetSwapchainImagesKHR", 1),
        ("vkCreateSemaphore", 1),
        ("vkAcquireNextImageKHR", 1),
        ("vkQueuePresentKHR", 2),
        ("vkQueueSubmit2", 30),
        ("vkWaitForFences", 30),
    ] {
        let output = desktop.faulty(&arguments, &format!("{call}:{first}:{}", result(call)));
        objects_to_nothing(Run::from(output)).failed(&["Vulkan could not"]);
        assert_eq!(kept.exists(), first == 30, "{call}");
        let _ = std::fs::remove_file(&kept);
    }
}
