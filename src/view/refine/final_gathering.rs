//! Final gathering while the lights rest: the picture of their indirect light becomes the right one.
//!
//! A low-priority thread gathers the lights of which least is known, and tells from time to time what it found. All is
//! kept by light, as it stands, at unit strength: a light that is recoloured, muted or put back by undo needs no work.
//! Any edit stops the thread; what it found until then is kept.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use glam::Vec3;

use super::gathered::{Gathered, GatheredLight, GatheringState};
use crate::bake::{DeepFramebuffer, at_rest, low_priority};
use crate::error::Result;
use crate::final_gather::{self, Estimate, FinalGather, LEAST_PASSES, Refined};
use crate::relight::{Detail, LightChanges, Picture, Relighter, Request, StandingLight};
use crate::scene::Rig;
use crate::trace::bvh::TracedScene;
use crate::view::LoadedScene;
use crate::view::loading::load::{LoadEvent, Messenger};
use crate::view::shares::mean_luminance;

/// What is known of the lights' indirect light, and the thread that finds more.
pub struct FinalGathering {
    /// Asked error; `None`: nothing is gathered.
    error: Option<f64>,
    messenger: Messenger,
    /// Latest last.
    known: Vec<Known>,
    changes: LightChanges,
    job: Option<Job>,
    /// Operator's images for the next job, by light.
    operator: Vec<(usize, Arc<Vec<Vec3>>)>,
    /// Whether all that was asked for is done, for the lights as they are.
    is_idle: bool,
    /// Whether changes that were shown wait for images of another operator.
    catches_up: bool,
    state: GatheringState,
    /// Mean luminance of the picture that the state belongs to.
    mean: f64,
    /// Counts what becomes known.
    version: u64,
    /// Time of the last edit.
    edited: Instant,
}

/// What is known of a light as it stands.
struct Known {
    light: StandingLight,
    estimate: Arc<Estimate>,
    /// Indirect light by the operator that its change belongs to; `None` if that was replaced.
    operator: Option<Arc<Vec<Vec3>>>,
    /// Expected squared error of each pixel at unit strength, relative to `errors2`.
    part: f64,
    errors2: Arc<Vec<f64>>,
}

/// A running thread.
struct Job {
    rig: Rig,
    /// Mean luminance of the picture.
    mean: f64,
    stop: Arc<AtomicBool>,
    /// Whether the operator is still the one of its images.
    has_operator: bool,
}

/// What a thread gathers.
struct Task {
    opened: (Arc<TracedScene>, Arc<DeepFramebuffer>),
    rig: Rig,
    lights: Vec<TaskLight>,
    /// Ends at so many passes of each light, if others have more.
    passes: Option<u32>,
    /// Mean of luminance over the picture times the asked error.
    asked: f64,
    /// Mean squared error of other lights.
    others: f64,
    seed: u64,
}

struct TaskLight {
    index: usize,
    operator: Arc<Vec<Vec3>>,
    before: Option<Arc<Estimate>>,
}

/// Gathering starts this long after the last edit.
const DELAY: Duration = Duration::from_millis(400);
/// A thread tells what it found when it has this many times more passes than the last time, and this long after.
const GROWTH: f64 = 1.25;
const INTERVAL: Duration = Duration::from_millis(700);
/// Passes that are made at once even if a bake needs a core.
const FIRST_PASSES: u32 = 2;
/// Passes of a light that reaches nothing.
const NOTHING_TO_FIND: u32 = u32::MAX;
/// Bytes of what is known, unless the lights of the rig alone need more.
const MOST_BYTES: usize = 1 << 30;
const BYTES_A_PIXEL: usize = 3 * size_of::<Vec3>() + 2 * size_of::<u32>() + size_of::<f64>();

impl FinalGathering {
    pub fn new(error: Option<f64>, messenger: Messenger) -> Self {
        Self {
            error,
            messenger,
            known: Vec::new(),
            changes: LightChanges::default(),
            job: None,
            operator: Vec::new(),
            is_idle: false,
            catches_up: false,
            state: GatheringState::default(),
            mean: 0.0,
            version: 0,
            edited: Instant::now(),
        }
    }

    /// What is added to pictures of lights.
    pub fn changes(&self) -> &LightChanges {
        &self.changes
    }

    pub fn state(&self) -> GatheringState {
        GatheringState { goes_on: !self.is_idle && self.state.expected_error.is_some(), ..self.state }
    }

    /// Changes with what [`Self::errors`] returns.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Records an edit: the thread stops.
    pub fn restart(&mut self, now: Instant) {
        self.edited = now;
        self.catches_up = false;
        self.stop();
    }

    fn stop(&mut self) {
        self.is_idle = false;
        self.operator.clear();
        self.state = GatheringState::default();
        self.version += 1;
        if let Some(job) = &self.job {
            job.stop.store(true, Ordering::Relaxed);
        }
    }

    /// Gathers no more, and forgets all.
    pub fn give_up(&mut self) {
        let messenger = self.messenger.clone();
        self.stop();
        *self = Self::new(None, messenger);
    }

    /// Forgets all that depends on the operator.
    pub fn forget_operator(&mut self) {
        self.stop();
        self.catches_up = !self.changes.is_empty();
        self.known.iter_mut().for_each(|known| known.operator = None);
        self.job.iter_mut().for_each(|job| job.has_operator = false);
        self.changes = LightChanges::default();
    }

    /// Whether a picture that was shown is still better than what could be made now.
    pub fn catches_up(&self) -> bool {
        self.catches_up
    }

    fn known(&self, rig: &Rig, light: usize) -> Option<&Known> {
        self.known.iter().find(|known| known.light.is(rig, light))
    }

    /// Expected squared error of each pixel for the lights as they are; `None` if there is a light of which nothing is
    /// known.
    fn errors2(&self, rig: &Rig) -> Option<Vec<f64>> {
        let mut sum: Vec<f64> = Vec::new();
        for light in shining(rig) {
            let known = self.known(rig, light)?;
            let weight = known.weight(rig.scale(light));
            sum.resize(known.errors2.len(), 0.0);
            sum.iter_mut().zip(known.errors2.iter()).for_each(|(sum, error2)| *sum += weight * error2);
        }
        Some(sum)
    }

    /// Expected error of each pixel, row by row, relative to the mean luminance of the picture; `None` before each
    /// light was gathered.
    pub fn errors(&self, rig: &Rig) -> Option<Vec<f32>> {
        let errors2 = self.errors2(rig).filter(|errors2| !errors2.is_empty() && self.mean > 0.0)?;
        Some(errors2.into_iter().map(|error2| (error2.sqrt() / self.mean) as f32).collect())
    }

    fn passes(&self, rig: &Rig, light: usize) -> u32 {
        self.known(rig, light).map_or(0, |known| known.estimate.passes)
    }

    /// Notes what is known of the lights as they are; `mean`: luminance of the picture.
    fn assess(&mut self, rig: &Rig, mean: f64) {
        let relative = |errors2: Vec<f64>| match final_gather::mean(&errors2).sqrt() {
            0.0 => 0.0, // also of black pictures
            error => error / mean,
        };
        self.state.expected_error = self.errors2(rig).map(relative);
        self.mean = mean;
        self.state.passes = shining(rig).map(|light| self.passes(rig, light)).min().unwrap_or(0);
    }

    /// When the next step is due, unless an event comes before.
    pub fn next_step_at(&self, opened: &LoadedScene) -> Option<Instant> {
        let waits = self.error.is_none() || opened.transfer.is_none() || self.job.is_some() || self.is_idle;
        (!waits).then(|| self.edited + DELAY)
    }

    /// Does one short step, if one is due: makes an image of the operator, or starts the thread. `relighter` has the
    /// lights. `is_baking`: a core is taken already. Returns the expected error once it is as small as asked.
    pub fn step(&mut self, opened: &LoadedScene, relighter: &mut Relighter, is_baking: bool) -> Result<Option<f64>> {
        let is_due = self.next_step_at(opened).is_some_and(|due| due <= Instant::now());
        let Some(asked) = self.error.filter(|_| is_due) else { return Ok(None) };
        relighter.set_changes(&self.changes)?;
        let rig = relighter.rig().clone();
        // What is missing of area lights is not waited for.
        let request = Request { detail: Detail::Progressive, ..Picture::Whole.into() };
        let mean = mean_luminance(relighter.linear(request)?).abs();
        self.assess(&rig, mean);
        let stale: Vec<usize> =
            shining(&rig).filter(|&i| self.known(&rig, i).is_some_and(|known| known.operator.is_none())).collect();
        let is_stale = !stale.is_empty();
        self.catches_up &= is_stale;
        let passes = |light: &usize| self.passes(&rig, *light);
        let lights = match is_stale {
            true => stale,
            false if self.state.passes >= LEAST_PASSES && self.state.expected_error.is_some_and(|e| e <= asked) => {
                Vec::new()
            }
            false => shining(&rig).filter(|light| passes(light) == self.state.passes).collect(),
        };
        if lights.is_empty() {
            self.is_idle = true;
            return Ok(self.state.expected_error);
        }
        let has_operator = |light: &usize| self.operator.iter().any(|(other, _)| other == light);
        if let Some(&light) = lights.iter().find(|light| !has_operator(light)) {
            let known = self.known(&rig, light).and_then(|known| known.operator.clone());
            let image = match known {
                Some(image) => Some(image),
                None => relighter.indirect_step(light)?.map(Arc::new),
            };
            self.operator.extend(image.map(|image| (light, image)));
            return Ok(None);
        }
        let has_more = |&passes: &u32| passes > self.state.passes && passes < NOTHING_TO_FIND;
        let more = shining(&rig).map(|light| passes(&light)).filter(has_more).min();
        let is_other = |light: &usize| !lights.contains(light);
        let others = shining(&rig).filter(is_other).filter_map(|light| {
            let known = self.known(&rig, light)?;
            Some(final_gather::mean(&known.errors2) * known.weight(rig.scale(light)))
        });
        let of_light = |&index: &usize| {
            let operator = self.operator.iter().find(|(light, _)| *light == index).expect("made above").1.clone();
            TaskLight { index, operator, before: self.known(&rig, index).map(|known| known.estimate.clone()) }
        };
        let task = Task {
            opened: (opened.scene.clone(), opened.framebuffer.clone()),
            lights: lights.iter().map(of_light).collect(),
            passes: more,
            asked: asked * mean,
            others: others.sum(),
            seed: 1 + u64::from(self.state.passes),
            rig: rig.clone(),
        };
        self.operator.clear();
        // Without waiting for the bake only until there is something to show.
        let gives_way = is_baking && self.state.passes > 0;
        let task = if is_baking && !gives_way { Task { passes: Some(FIRST_PASSES), ..task } } else { task };
        let stop = Arc::new(AtomicBool::new(false));
        self.job = Some(Job { rig, mean, stop: stop.clone(), has_operator: true });
        let messenger = self.messenger.clone();
        // Not joined, so that closing the window does not wait for it. Sending fails only after the window is closed.
        std::thread::spawn(move || {
            let tell = |gathered: Option<Gathered>| messenger.send(LoadEvent::Gathered(gathered.map(Box::new)));
            let run = AssertUnwindSafe(|| {
                let run = || task.run(&stop, |gathered| tell(Some(gathered)));
                if gives_way { low_priority(run) } else { at_rest(run) }
            });
            if catch_unwind(run).is_err() {
                tell(None);
            }
        });
        Ok(None)
    }

    /// Accepts what the thread found.
    pub fn accept(&mut self, gathered: Gathered, opened: &LoadedScene, relighter: &Relighter) -> Result<()> {
        let Some(job) = &self.job else { return Ok(()) };
        let (rig, mean, has_operator) = (job.rig.clone(), job.mean, job.has_operator);
        let has_stopped = job.stop.load(Ordering::Relaxed);
        let pixels = (opened.framebuffer.tiling.width * opened.framebuffer.tiling.height) as usize;
        let most = rig.lights.len().max(MOST_BYTES / (BYTES_A_PIXEL * pixels.max(1)));
        if gathered.has_ended {
            self.job = None;
        }
        self.catches_up &= !has_operator;
        for GatheredLight { index, operator, estimate, change, part } in gathered.lights {
            // The lights may stand elsewhere by now, but what is known of them as they stood stays.
            if has_operator {
                self.changes.set(relighter.context(), &opened.framebuffer, (&rig, index), &change, most)?;
            }
            self.known.retain(|known| !known.light.is(&rig, index));
            self.known.push(Known {
                light: StandingLight::new(&rig, index),
                estimate,
                operator: has_operator.then_some(operator),
                part,
                errors2: gathered.errors2.clone(),
            });
        }
        self.known.drain(..self.known.len().saturating_sub(most));
        self.version += 1;
        if !has_stopped {
            self.assess(&rig, mean);
        }
        Ok(())
    }
}

impl Drop for FinalGathering {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Known {
    /// What its part of `errors2` is multiplied by, at a scale of the light.
    fn weight(&self, scale: Vec3) -> f64 {
        self.part * scale.as_dvec3().length_squared() / 3.0
    }
}

impl Task {
    /// Tells what it finds until `tell` returns false, `stop` is set, the asked error is met or the passes are made.
    fn run(self, stop: &AtomicBool, tell: impl Fn(Gathered) -> bool) {
        let Self { opened: (scene, framebuffer), rig, lights, .. } = &self;
        let before: u32 = lights.iter().map(TaskLight::passes).min().unwrap_or(0);
        let mut told = before;
        if before >= 2 && lights.iter().all(|light| light.before.is_some()) {
            // What is known already may be met by another picture of the operator.
            let gathered = self.gathered(None);
            let (is_enough, gathered) = (self.is_enough(&gathered), gathered);
            let has_ended = is_enough || stop.load(Ordering::Relaxed);
            if !tell(Gathered { has_ended, ..gathered }) || has_ended {
                return;
            }
        }
        let wanted = |light| lights.iter().any(|wanted| wanted.index == light);
        let mut gather = FinalGather::new(scene, framebuffer, rig, wanted, self.seed, before);
        let mut told_at = Instant::now();
        let mut whole_passes = 0;
        loop {
            gather.pass(&|| stop.load(Ordering::Relaxed));
            let has_stopped = stop.load(Ordering::Relaxed);
            whole_passes += u32::from(!has_stopped);
            let passes = before.saturating_add(whole_passes);
            let is_full = self.passes.is_some_and(|most| passes >= most);
            let is_due =
                told == before || f64::from(passes) >= GROWTH * f64::from(told) && told_at.elapsed() >= INTERVAL;
            if whole_passes < 2 {
                if has_stopped {
                    tell(Gathered { lights: Vec::new(), errors2: Default::default(), has_ended: true });
                    return;
                }
                continue;
            }
            if !is_due && !has_stopped && !is_full {
                continue;
            }
            let gathered = self.gathered(Some(&gather));
            gather.focus(&gathered.errors2);
            let has_ended = has_stopped || is_full || self.is_enough(&gathered);
            (told, told_at) = (passes, Instant::now());
            if !tell(Gathered { has_ended, ..gathered }) || has_ended {
                return;
            }
        }
    }

    /// Refines the pictures by what was known and what was found.
    fn gathered(&self, gather: Option<&FinalGather>) -> Gathered {
        let count = self.lights[0].operator.len();
        let sources: Vec<usize> = gather.iter().flat_map(|gather| gather.lights()).collect();
        let black = || Estimate {
            halves: [(); 2].map(|()| vec![Vec3::ZERO; count]),
            rays: [(); 2].map(|()| vec![1; count]),
            passes: NOTHING_TO_FIND,
        };
        let estimate = |light: &TaskLight| {
            let source = sources.iter().position(|&source| source == light.index);
            let found = gather.zip(source).map(|(gather, source)| gather.estimate(source));
            match (found, &light.before) {
                (Some(found), Some(before)) => Arc::new(found.joined(before)),
                (Some(found), None) => Arc::new(found),
                (None, Some(before)) => before.clone(),
                // It sends no light.
                (None, None) => Arc::new(black()),
            }
        };
        let estimates: Vec<Arc<Estimate>> = self.lights.iter().map(estimate).collect();
        let of_lights: Vec<_> = self
            .lights
            .iter()
            .zip(&estimates)
            .map(|(light, estimate)| (self.rig.scale(light.index), &light.operator[..], &**estimate))
            .collect();
        let width = self.opened.1.tiling.width as usize;
        let Refined { changes, errors2, parts } = Refined::new(width, &of_lights);
        let lights = self.lights.iter().zip(estimates).zip(changes.into_iter().zip(parts));
        let lights = lights.map(|((light, estimate), (change, part))| GatheredLight {
            index: light.index,
            operator: light.operator.clone(),
            estimate,
            change,
            part,
        });
        Gathered { lights: lights.collect(), errors2: Arc::new(errors2), has_ended: false }
    }

    fn is_enough(&self, gathered: &Gathered) -> bool {
        let errors2 = &gathered.errors2;
        let passes = gathered.lights.iter().map(|light| light.estimate.passes).min().unwrap_or(0);
        self.passes.is_none()
            && passes >= LEAST_PASSES
            && (final_gather::mean(errors2) + self.others).sqrt() <= self.asked
    }
}

impl TaskLight {
    fn passes(&self) -> u32 {
        self.before.as_ref().map_or(0, |before| before.passes)
    }
}

/// Lights that are not off.
fn shining(rig: &Rig) -> impl Iterator<Item = usize> {
    (0..rig.lights.len()).filter(|&light| rig.scale(light) != Vec3::ZERO)
}
