//! The library as its users have it: from a file to a picture in a few lines.

mod command;

use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

use command::{folder, shipped};
use relume::bake::transport::Outgoing;
use relume::session::{Form, IndirectSettings, Progress};
use relume::{Error, Session, SessionSettings};

/// Few samples and rays: what is tested does not depend on them.
fn small() -> SessionSettings {
    let IndirectSettings::Robust { outgoing, .. } = IndirectSettings::default() else { panic!("ours is the default") };
    let (gather, rays, bounces) = (Some(60), Some(16), None);
    let indirect = Some(IndirectSettings::Robust { outgoing, form: Form::Nested(0.1), gather, rays, bounces });
    let mut settings = SessionSettings { indirect, cache_dir: None, ..Default::default() };
    settings.open.size = Some([32, 24]);
    settings
}

/// Has enough after so many steps.
struct Impatient {
    steps: AtomicUsize,
    most: usize,
}

impl Progress for Impatient {
    fn advance(&self, _: usize) {
        self.steps.fetch_add(1, Ordering::Relaxed);
    }

    fn is_cancelled(&self) -> bool {
        self.steps.load(Ordering::Relaxed) >= self.most
    }
}

/// Wherever a bake is stopped, the next one takes what it left and ends with the same result.
#[test]
fn work_that_is_cancelled_ends_and_can_be_done_again() {
    let scene = shipped("cornell-glossy.glb");
    let counted = Impatient { steps: AtomicUsize::new(0), most: usize::MAX };
    let whole = Session::open(&scene, None, &small(), &counted).unwrap();
    let steps = counted.steps.into_inner();
    for most in [1, steps / 4, steps / 2, 3 * steps / 4] {
        let folder = folder();
        let settings = SessionSettings { cache_dir: Some(folder.path().to_owned()), ..small() };
        let impatient = Impatient { steps: AtomicUsize::new(0), most };
        let stopped = Session::open(&scene, None, &settings, &impatient);
        assert!(matches!(stopped, Err(Error::Cancelled)), "after {most} of {steps} steps");
        let again = Session::open(&scene, None, &settings, &()).unwrap();
        let factors = |session: &Session| {
            let transfer = session.transfer.as_ref().unwrap();
            transfer.chain.iter().map(|matrix| matrix.values.to_vec()).collect::<Vec<_>>()
        };
        assert!(factors(&again) == factors(&whole), "after {most} of {steps} steps");
    }
}

#[test]
fn numbers_that_mean_nothing_are_refused() {
    let IndirectSettings::Robust { outgoing, form, gather, rays, bounces } = small().indirect.unwrap() else {
        panic!("ours is the default")
    };
    let robust = |outgoing, form, gather, rays| {
        let indirect = Some(IndirectSettings::Robust { outgoing, form, gather, rays, bounces });
        SessionSettings { indirect, ..small() }
    };
    let five = Outgoing::Glossy { functions: Some(5) };
    let wrong = [
        SessionSettings { layers: 0, force_all: true, ..small() },
        SessionSettings { samples: 0, ..small() },
        robust(outgoing, form, Some(0), rays),
        robust(outgoing, form, gather, Some(0)),
        robust(outgoing, Form::Nested(f64::NAN), None, None),
        robust(outgoing, Form::Haar(0.0), None, None),
        robust(five, form, gather, rays),
    ];
    for settings in wrong {
        let refused = Session::open(&shipped("cornell-glossy.glb"), None, &settings, &());
        assert!(matches!(refused, Err(Error::Invalid { .. })), "{settings:?}");
    }
}

#[test]
fn nothing_is_left_out_of_the_transfer_where_that_is_asked_for() {
    let scene = shipped("cornell-diffuse.glb");
    let open = |force_all: bool, samples: u32| {
        let settings = SessionSettings { force_all, samples, ..small() };
        Session::open(&scene, None, &settings, &()).unwrap()
    };
    let transfer = |session: &Session| session.transfer.clone().unwrap();
    assert!(transfer(&open(false, 1)).samples.iter().all(|sample| sample.degrees == 1), "nothing is glossy");
    for samples in [1, 4] {
        let forced = open(true, samples);
        assert!(transfer(&forced).all_degrees, "{samples} samples");
    }
}

#[test]
fn the_example_writes_a_picture() {
    let folder = folder();
    let binary = std::path::Path::new(env!("CARGO_BIN_EXE_relume")).with_file_name("examples").join("relight");
    if !binary.exists() {
        return println!(
            "not run: examples/relight.rs, which `cargo test` compiles, and `cargo test --test session` does not"
        );
    }
    let out = folder.path().join("balls.png");
    let cache = folder.path().join("cache");
    let run =
        Command::new(binary).arg(shipped("balls-2.glb")).arg(&out).env("XDG_CACHE_HOME", &cache).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let picture = image::open(&out).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (192, 128));
    let mean = picture.as_raw().iter().map(|&v| f64::from(v)).sum::<f64>() / picture.as_raw().len() as f64;
    assert!((40.0..200.0).contains(&mean), "a mean of {mean}");
}
