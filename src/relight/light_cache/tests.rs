//! Plans executed with numbers in place of images: the picture is always the sum of all lights.

use glam::DVec3;
use proptest::prelude::*;

use super::*;
use crate::scene::LightGroup;

/// Executes plans with numbers in place of images. A light's image is its x coordinate; each point of a light with a
/// size contributes another number, and their mean is that.
struct Numbers {
    slots: Vec<f32>,
    rest: f32,
    some_points: f32,
    checkpoint: f32,
    shaded: usize,
    /// A light that was compared, and its change.
    change: Option<(usize, f32)>,
}

/// Materials of emitters that are seen, and what stands for their images.
const EMITTERS: [(&str, f32); 2] = [("shade", 1000.0), ("screen", 64.0)];
/// Error of coarse images.
const OFF: f32 = 0.25;
/// Relative error of interleaved points.
const INTERLEAVED_OFF: f32 = 0.125;

impl Numbers {
    fn new(slot_count: usize) -> Self {
        let [rest, some_points, checkpoint] = [f32::NAN; 3];
        Self { slots: vec![f32::NAN; slot_count], rest, some_points, checkpoint, shaded: 0, change: None }
    }

    fn value(&self, term: &Term) -> f32 {
        term.scale.x
            * match term.source {
                Source::Slot(slot) => self.slots[slot],
                Source::Rest => self.rest,
                Source::Emitter(index) => EMITTERS[index].1,
                Source::SomePoints => self.some_points,
                Source::Checkpoint => self.checkpoint,
                Source::Change(number) => number as f32,
            }
    }

    fn run(&mut self, rig: &Rig, mut plan: Plan) -> f32 {
        plan.batch_shades();
        for step in &plan.steps {
            match step {
                Step::Shade(Shade { light, target, detail, points }) => {
                    let off = if *detail == Detail::Coarse { OFF } else { 0.0 };
                    let mean = match *points {
                        LightPoints::One => 1.0,
                        LightPoints::Interleaved => 1.0 + INTERLEAVED_OFF,
                        LightPoints::Some { first, end, of } => {
                            // Each 64 points have the mean of all, half of them have not.
                            assert!(end <= of);
                            let number = |point: u32| 1.0 + ((point % 64) as f32 - 31.5) / 64.0;
                            (first..end).map(number).sum::<f32>() / points.count() as f32
                        }
                    };
                    let value = rig.lights[*light].position.x as f32 * mean + off;
                    match target {
                        Source::Slot(slot) => self.slots[*slot] = value,
                        Source::SomePoints => self.some_points = value,
                        Source::Rest | Source::Emitter(_) | Source::Checkpoint | Source::Change(_) => unreachable!(),
                    }
                    self.shaded += 1;
                }
                Step::Sum { target, terms, kept } => {
                    let term = Term { source: *target, scale: Vec3::splat(*kept) };
                    let old = if *kept > 0.0 { self.value(&term) } else { 0.0 };
                    let sum = old + terms.iter().map(|t| self.value(t)).sum::<f32>();
                    match target {
                        Source::Slot(slot) => self.slots[*slot] = sum,
                        Source::Rest => self.rest = sum,
                        Source::Checkpoint => self.checkpoint = sum,
                        Source::Emitter(_) | Source::SomePoints | Source::Change(_) => unreachable!(),
                    }
                }
                Step::Compare { light, image } => {
                    // At each checkpoint an image has the mean of all points.
                    let image = Term { source: *image, scale: Vec3::ONE };
                    assert!((self.value(&image) - self.checkpoint).abs() <= 1e-5 * self.checkpoint.abs());
                    let change = [0.0, 0.02, 1.0][rig.lights[*light].position.y as usize];
                    assert_eq!(self.change.replace((*light, change)), None);
                }
                Step::Show { .. } => unreachable!("no sheet is planned"),
            }
        }
        plan.picture.iter().map(|t| self.value(t)).sum()
    }
}

/// Runs a plan, and tells the cache what its comparisons found.
fn run(cache: &mut LightCache, numbers: &mut Numbers, rig: &Rig, plan: Plan) -> f32 {
    let picture = numbers.run(rig, plan);
    numbers.change.take().into_iter().for_each(|(light, change)| cache.set_change(light, change));
    picture
}

/// Renders area lights until it is known how many points each needs.
fn decide(cache: &mut LightCache, numbers: &mut Numbers, rig: &Rig) {
    while let Some(light) = cache.undecided() {
        let plan = cache.plan_part(light, u32::MAX);
        assert!(!plan.steps.is_empty());
        run(cache, numbers, rig, plan);
    }
}

/// What stands for the image of a light.
fn image(light: &Light) -> f32 {
    match &light.material {
        Some(material) => EMITTERS.iter().find(|(known, _)| known == material).map_or(0.0, |(_, image)| *image),
        None => light.position.x as f32,
    }
}

/// The same with its change.
fn image_with(light: &Light, changes: &HashMap<String, u64>) -> f32 {
    image(light) + changes.get(&light.name).map_or(0.0, |number| *number as f32)
}

fn truth(rig: &Rig) -> f32 {
    truth_with(rig, &HashMap::new())
}

fn truth_with(rig: &Rig, changes: &HashMap<String, u64>) -> f32 {
    let rig = rig.with_solo_applied();
    let one = |l: &Light| {
        let group = l.group.map_or(1.0, |g| rig.groups[g].scale().x);
        image_with(l, changes) * l.scale().x * group
    };
    rig.lights.iter().map(one).sum()
}

fn rig(light_count: usize, group_count: usize) -> Rig {
    let group = |i| LightGroup::new(&format!("g{i}"));
    let light = |i: usize| {
        let group = (!i.is_multiple_of(3) && group_count > 0).then(|| i % group_count.max(1));
        Light { group, ..Light::point(&format!("l{i}"), DVec3::new(i as f64, (i % 3) as f64, 0.0)) }
    };
    Rig {
        groups: (0..group_count).map(group).collect(),
        lights: (0..light_count).map(light).collect(),
        ..Rig::default()
    }
}

/// Each area light gets as many points as it needs, also while others are switched off and on again.
#[test]
fn pictures_at_rest_become_exact() {
    let mut rig = rig(9, 2);
    rig.lights.iter_mut().for_each(|light| light.radius = 1.0);
    // Room for all that grow.
    let slot_count = 3 * rig.lights.len();
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    cache.set_detail(Detail::Progressive);
    let mut numbers = Numbers::new(slot_count);
    for frame in 0..2000 {
        rig.lights[1].enabled = !(10..100).contains(&frame);
        cache.set_rig(&rig, slot_count);
        let plan = cache.plan(usize::MAX);
        let picture = run(&mut cache, &mut numbers, &rig, plan);
        if !cache.is_coarse() {
            assert!(is_near(&rig, picture, truth(&rig)));
            // Of each three lights, one is found to need 256 points, two to need all.
            assert_eq!(numbers.shaded, 9 + 3 * (256 + 1280 + 1280) / POINTS_A_STEP as usize);
            return;
        }
    }
    panic!("the picture is still coarse");
}

/// Thousands of lights get their images over several pictures, each of which shows those that have one.
#[test]
fn pictures_lack_lights_until_all_have_images() {
    let rig = rig(100, 3);
    let (fewest, most) = LightCache::slot_range(rig.lights.len());
    // Where slots are scarce, fewer images are begun at a time.
    for (slot_count, most_frames) in [(most, 9), (fewest, 17)] {
        let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
        cache.set_detail(Detail::Progressive);
        let mut numbers = Numbers::new(slot_count);
        // Light 0 is black. In the focus, it is not counted.
        cache.select(&[0]);
        for frame in 1..=most_frames {
            let plan = cache.plan(11);
            let picture = run(&mut cache, &mut numbers, &rig, plan);
            assert!(numbers.shaded <= 1 + 11 * frame);
            assert_eq!(cache.is_coarse(), cache.lacking() > 0);
            assert_eq!(picture == truth(&rig), cache.lacking() == 0, "{} lights are lacking", cache.lacking());
        }
        assert_eq!(cache.lacking(), 0);
    }
}

/// Hundreds of area lights get their points over several pictures, each of which shades few and sums few images.
#[test]
fn points_of_many_lights_come_over_several_pictures() {
    let mut rig = rig(100, 3);
    rig.lights.iter_mut().for_each(|light| light.radius = 1.0);
    let slot_count = LightCache::slot_range(rig.lights.len()).1;
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    cache.set_detail(Detail::Progressive);
    let mut numbers = Numbers::new(slot_count);
    for frame in 0..20_000 {
        rig.lights[5].intensity = f64::from(1 + frame / 100);
        cache.set_rig(&rig, slot_count);
        let plan = cache.plan(16);
        let shades = plan.steps.iter().filter_map(Step::as_shade).count();
        // Besides those of light 5, which is in the focus.
        let most = match frame {
            0..7 => 16,
            _ if frame % 100 == 0 => 0,
            _ => 2,
        };
        assert!(shades <= most + 1, "{shades} shades in frame {frame}");
        assert!(plan.steps.len() <= 80, "{} steps in frame {frame}", plan.steps.len());
        let picture = run(&mut cache, &mut numbers, &rig, plan);
        if !cache.is_coarse() {
            assert!(is_near(&rig, picture, truth(&rig)));
            // As in `pictures_at_rest_become_exact`; light 0 is black.
            assert_eq!(numbers.shaded, 100 + (34 * 256 + 66 * 1280) / POINTS_A_STEP as usize);
            return;
        }
    }
    panic!("the picture is still coarse");
}

proptest! {
    /// For any edits in any order and any number of slots, the picture is the sum of all lights. A coarse picture is
    /// reported as coarse, and its exact version is that sum again.
    #[test]
    fn picture_is_the_sum(
        light_count in 0usize..40,
        group_count in 0usize..4,
        scarce in any::<bool>(),
        edits in prop::collection::vec((0usize..18, 0usize..1000, 1usize..20), 0..40),
    ) {
        let mut rig = rig(light_count, group_count);
        for (i, light) in rig.lights.iter_mut().enumerate().filter(|(i, _)| i % 4 == 1) {
            let material = ["shade", "screen", "hidden"][i % 3];
            *light = Light { group: light.group, ..Light::emitter(&light.name, material) };
        }
        let emitters = EMITTERS.iter().enumerate().map(|(index, (material, _))| ((*material).into(), index)).collect();
        let (fewest, most) = LightCache::slot_range(light_count);
        let slot_count = if scarce { fewest } else { most };
        let mut cache = LightCache::new(&rig, slot_count, emitters);
        let mut numbers = Numbers::new(slot_count);
        let mut detail = Detail::Exact;
        let mut most_points = usize::MAX;
        // By name of the light.
        let mut changes = HashMap::new();
        for (kind, which, amount) in edits {
            let lights = rig.lights.len();
            let amount_f = amount as f64;
            match kind {
                0 if lights > 0 => rig.lights[which % lights].position.x = amount_f,
                1 if lights > 0 => rig.lights[which % lights].intensity = amount_f,
                2 if lights > 0 => rig.lights[which % lights].enabled ^= true,
                3 if group_count > 0 => rig.groups[which % group_count].enabled ^= true,
                4 if group_count > 0 => rig.groups[which % group_count].stops = (amount % 4) as f64,
                5 if lights > 0 => {
                    for i in 0..amount {
                        rig.lights[(which + i) % lights].position.x += 1.0;
                    }
                }
                7 if lights > 0 => rig.lights[which % lights].solo ^= true,
                8 if group_count > 0 => rig.groups[which % group_count].solo ^= true,
                6 if lights > 1 && amount < 10 => drop(rig.lights.remove(which % lights)),
                6 => {
                    for i in 0..amount {
                        let name = format!("new{}-{i}", rig.lights.iter().map(|l| l.name.len()).sum::<usize>());
                        rig.lights.push(Light::point(&name, DVec3::new(amount_f, 0.0, 0.0)));
                    }
                }
                10 => detail = Detail::Coarse,
                11 => detail = Detail::Exact,
                14 => detail = Detail::Progressive,
                12 if lights > 0 => rig.lights[which % lights].radius = (amount % 2) as f64,
                13 if lights > 0 => {
                    let plan = cache.plan_part(which % lights, 1);
                    run(&mut cache, &mut numbers, &rig, plan);
                }
                15 if lights > 0 => _ = changes.insert(rig.lights[which % lights].name.clone(), amount as u64),
                17 => most_points = amount % 5,
                16 if lights > 0 => _ = changes.remove(&rig.lights[which % lights].name),
                _ => {}
            }
            let (fewest, most) = LightCache::slot_range(rig.lights.len());
            let slot_count = if scarce { fewest } else { most };
            numbers.slots.resize(slot_count.max(numbers.slots.len()), f32::NAN);
            cache.set_rig(&rig, slot_count);
            cache.set_changes(|rig, light| changes.get(&rig.lights[light].name).copied());
            if kind == 9 || which % 3 == 0 {
                let lights = rig.lights.len();
                cache.select(&(0..lights).filter(|i| (i + which) % (1 + amount / 4) == 0).collect::<Vec<_>>());
            }
            cache.set_detail(detail);
            if detail == Detail::Exact {
                decide(&mut cache, &mut numbers, &rig);
            }
            let plan = cache.plan(if detail == Detail::Exact { usize::MAX } else { most_points });
            let picture = run(&mut cache, &mut numbers, &rig, plan);
            prop_assert!(detail != Detail::Exact || !cache.is_coarse());
            prop_assert!(cache.lacking() == 0 || cache.is_coarse());
            prop_assert!(cache.is_coarse() || is_near(&rig, picture, truth_with(&rig, &changes)));
            if which % 5 == 0 {
                let plan = cache.plan_emitters();
                let emitters = Rig {
                    lights: rig.with_solo_applied().lights.iter().filter(|l| l.material.is_some()).cloned().collect(),
                    ..rig.clone()
                };
                prop_assert_eq!(run(&mut cache, &mut numbers, &rig, plan), truth_with(&emitters, &changes));
            }
            if !rig.lights.is_empty() {
                let one = which % rig.lights.len();
                let alone = cache.plan_light(one);
                let rig = rig.with_solo_applied();
                let light = &rig.lights[one];
                let group = light.group.map_or(1.0, |g| rig.groups[g].scale().x);
                let want = image_with(light, &changes) * light.scale().x * group;
                let alone = run(&mut cache, &mut numbers, &rig, alone);
                prop_assert!(cache.is_coarse() || is_near(&rig, alone, want));
            }
        }
        cache.set_detail(Detail::Exact);
        decide(&mut cache, &mut numbers, &rig);
        let plan = cache.plan(usize::MAX);
        prop_assert!(is_near(&rig, run(&mut cache, &mut numbers, &rig, plan), truth_with(&rig, &changes)));
        prop_assert!(!cache.is_coarse());
        prop_assert!(scarce || cache.pending().0 == 0);
    }
}

/// Equal; near if lights have a size, because means over points are rounded.
fn is_near(rig: &Rig, a: f32, b: f32) -> bool {
    let allowed = if rig.lights.iter().all(Light::is_punctual) { 0.0 } else { 1e-5 * b };
    (a - b).abs() <= allowed
}

#[test]
fn colour_edits_shade_nothing_and_sum_nothing() {
    let mut rig = rig(256, 0);
    let slot_count = LightCache::slot_range(256).1;
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    cache.plan(usize::MAX);
    cache.select(&[17]);
    cache.plan(usize::MAX);
    rig.lights[17].intensity = 3.0;
    cache.set_rig(&rig, slot_count);
    let plan = cache.plan(usize::MAX);
    assert!(plan.steps.is_empty(), "{:?}", plan.steps);
    assert_eq!(plan.picture.len(), 2);
}

#[test]
fn a_group_in_focus_is_one_image() {
    let mut rig = rig(64, 2);
    let slot_count = LightCache::slot_range(64).1;
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    let members: Vec<usize> = (0..64).filter(|&i| rig.lights[i].group == Some(1)).collect();
    cache.select(&members);
    cache.plan(usize::MAX);
    rig.groups[1].stops = 1.0;
    cache.set_rig(&rig, slot_count);
    cache.select(&members);
    let plan = cache.plan(usize::MAX);
    assert_eq!((plan.steps.len(), plan.picture.len()), (0, 2));
}

#[test]
fn selecting_another_light_costs_a_logarithm() {
    let mut rig = rig(256, 0);
    let slot_count = LightCache::slot_range(256).1;
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    cache.plan(usize::MAX);
    for light in [3, 250, 130, 4] {
        rig.lights[light].position.x += 1.0;
        cache.set_rig(&rig, slot_count);
        let images: usize = cache
            .plan(usize::MAX)
            .steps
            .iter()
            .map(|step| match step {
                Step::Shade(_) => 0,
                Step::Sum { terms, .. } => terms.len() + 1,
                Step::Compare { .. } => unreachable!("no light has a size"),
                Step::Show { .. } => unreachable!("no sheet is planned"),
            })
            .sum();
        assert!(images <= 3 * 8 + 9, "{images} images for 256 lights");
    }
}

/// Adding and then editing 100,000 lights takes a number of steps linear in their number. A quadratic plan would take
/// minutes.
#[test]
fn a_hundred_thousand_lights() {
    let mut rig = rig(100_000, 0);
    rig.lights.iter_mut().for_each(|light| light.position.x = 1.0);
    let slot_count = LightCache::slot_range(rig.lights.len()).1;
    let mut cache = LightCache::new(&rig, slot_count, HashMap::new());
    let mut numbers = Numbers::new(slot_count);
    assert_eq!(numbers.run(&rig, cache.plan(usize::MAX)), truth(&rig));
    rig.lights.iter_mut().for_each(|light| light.position.x = 2.0);
    cache.set_rig(&rig, slot_count);
    assert_eq!(numbers.run(&rig, cache.plan(usize::MAX)), 200_000.0);
    assert_eq!(numbers.shaded, 200_000);
}
