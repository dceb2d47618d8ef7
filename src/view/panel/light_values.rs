//! Values of the selected lights: those of the primary light, or "mixed" if the lights differ. An edit changes all
//! selected lights in the same way.

use egui::{DragValue, Grid, Ui};
use glam::{DVec3, Vec3};

use crate::desk::{Desk, SizeKeeps, luminance};
use crate::scene::rig::{KELVIN, TINT, kelvin_and_tint_of, kelvin_to_rgb};
use crate::scene::sky_map::TURBIDITY;
use crate::scene::{DomeMap, Light, LightGroup, LightKind, LightUnit, PhysicalSky};

/// The selected lights, the primary last.
pub struct Selected<'a> {
    lights: Vec<&'a Light>,
}

impl<'a> Selected<'a> {
    pub fn of(desk: &'a Desk) -> Self {
        Self { lights: desk.selection().iter().map(|index| &desk.rig().lights[index]).collect() }
    }

    fn differ<T: PartialEq>(&self, value: impl Fn(&Light) -> T) -> bool {
        let mut values = self.lights.iter().map(|light| value(light));
        values.next().is_some_and(|first| values.any(|other| other != first))
    }

    /// Returns a number field, which shows "mixed" if the lights differ.
    pub fn number<'v>(&self, value: &'v mut f64, of: impl Fn(&Light) -> f64) -> DragValue<'v> {
        let field = DragValue::new(value);
        match self.differ(&of) {
            true => field.custom_formatter(|_, _| "mixed".into()),
            false => field,
        }
    }

    pub fn switch(&self, ui: &mut Ui, value: &mut bool, text: &str, of: impl Fn(&Light) -> bool) {
        ui.add(egui::Checkbox::new(value, text).indeterminate(self.differ(of)));
    }

    fn vector(&self, ui: &mut Ui, v: &mut DVec3, speed: f64, of: impl Fn(&Light) -> DVec3) {
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 3.0;
            for (axis, x) in v.as_mut().iter_mut().enumerate() {
                ui.add(self.number(x, |light| of(light)[axis]).speed(speed).max_decimals(3));
            }
        });
    }

    fn all_have(&self, kinds: &[LightKind]) -> bool {
        self.lights.iter().all(|light| kinds.contains(&light.kind))
    }
}

/// `unit`: in which intensity is shown, where it fits.
pub fn light_values(ui: &mut Ui, desk: &mut Desk, unit: &mut LightUnit) {
    let Some(primary) = desk.selected_light() else {
        ui.label("no light is selected");
        return;
    };
    let mut light = primary.clone();
    let mut size_keeps = desk.size_keeps;
    let selected = Selected::of(desk);
    if selected.lights.len() > 1 {
        ui.label(format!("{} lights; an edit changes all of them", selected.lights.len()));
    }
    Grid::new("light").num_columns(2).spacing([8.0, 4.0]).show(ui, |ui| {
        ui.label("name");
        name(ui, &mut light.name);
        ui.end_row();

        ui.label("");
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            selected.switch(ui, &mut light.enabled, "on", |light| light.enabled);
            selected.switch(ui, &mut light.solo, "solo", |light| light.solo);
            selected.switch(ui, &mut light.shadows, "shadows", |light| light.shadows);
            if !light.is_punctual() {
                selected.switch(ui, &mut light.visible, "visible", |light| light.visible);
            }
        });
        ui.end_row();

        strength(ui, &selected, &mut light, unit);
        color(ui, &selected, &mut light);
        pose(ui, &selected, &mut light, desk.step());
        cone(ui, &selected, &mut light);
        size(ui, &selected, &mut light, desk.step(), &mut size_keeps);
        physical_sky(ui, &selected, &mut light);
        range(ui, &selected, &mut light, desk.step());
    });
    desk.size_keeps = size_keeps;
    desk.edit_primary_and_selection(light);
    group_values(ui, desk);
    follow_values(ui, desk);
}

/// Draws a name field. The name is applied only when the field loses focus, so that typing is one edit.
fn name(ui: &mut Ui, name: &mut String) {
    let id = ui.id().with(("name", &*name));
    let mut typed = ui.data(|data| data.get_temp::<String>(id)).unwrap_or_else(|| name.clone());
    let field = ui.text_edit_singleline(&mut typed);
    if field.lost_focus() {
        *name = typed.replace('.', "_");
        ui.data_mut(|data| data.remove::<String>(id));
    } else if field.changed() {
        ui.data_mut(|data| data.insert_temp(id, typed));
    }
}

fn strength(ui: &mut Ui, selected: &Selected, light: &mut Light, unit: &mut LightUnit) {
    ui.label("intensity");
    ui.horizontal(|ui| {
        let shown = light.fitting(*unit);
        let factor = |light: &Light| light.per_intensity(light.fitting(*unit)).unwrap_or(1.0);
        let per_intensity = factor(light);
        let before = light.intensity * per_intensity;
        let mut strength = before;
        let range = 0.0..=f64::from(f32::MAX) * per_intensity;
        let field = selected.number(&mut strength, |light| light.intensity * factor(light));
        ui.add(field.speed((before * 0.01).max(1e-6)).range(range));
        if strength != before {
            light.intensity = strength / per_intensity;
        }
        let menu = egui::ComboBox::from_id_salt("unit").width(56.0).selected_text(shown.symbol(light.kind));
        menu.show_ui(ui, |ui| {
            for fitting in light.units() {
                if ui.selectable_label(fitting == shown, fitting.symbol(light.kind)).clicked() {
                    *unit = fitting;
                }
            }
        });
    });
    ui.end_row();
    ui.label("stops");
    let field = selected.number(&mut light.stops, |light| light.stops);
    ui.add(field.speed(0.02).range(-60.0..=60.0).max_decimals(2));
    ui.end_row();
}

fn color(ui: &mut Ui, selected: &Selected, light: &mut Light) {
    ui.label("kelvin");
    ui.horizontal(|ui| {
        let before = kelvin_and_tint_of(light.color);
        let (mut kelvin, mut tint) = before;
        let field = selected.number(&mut kelvin, |light| kelvin_and_tint_of(light.color).0);
        ui.add(field.speed(20.0).range(KELVIN).max_decimals(0).suffix(" K"));
        ui.label("tint");
        let field = selected.number(&mut tint, |light| kelvin_and_tint_of(light.color).1);
        let shown = ui.add(field.speed(0.005).range(TINT).max_decimals(3));
        shown.on_hover_text("green above zero, magenta below");
        if (kelvin, tint) != before {
            light.color = kelvin_to_rgb(kelvin, tint) * luminance(light.color);
        }
    });
    ui.end_row();
    ui.label("colour");
    ui.horizontal(|ui| {
        let mut color = color_button(ui, light.color);
        for (channel, value) in color.iter_mut().enumerate() {
            let mut wide = f64::from(*value);
            let field = selected.number(&mut wide, |light| light.color[channel].into());
            if ui.add(field.speed(0.005).range(0.0..=1e6).max_decimals(3)).changed() {
                *value = wide as f32;
            }
        }
        light.color = Vec3::from_array(color);
    });
    ui.end_row();
}

/// Draws a colour button. Returns `color` exactly unless it was edited, since egui rounds colours.
pub fn color_button(ui: &mut Ui, color: Vec3) -> [f32; 3] {
    let mut edited = color.to_array();
    let is_edited = ui.color_edit_button_rgb(&mut edited).changed();
    if is_edited { edited } else { color.to_array() }
}

fn pose(ui: &mut Ui, selected: &Selected, light: &mut Light, step: f64) {
    if light.kind.has_position() {
        ui.label("position");
        selected.vector(ui, &mut light.position, step * 0.1, |light| light.position);
        ui.end_row();
    }
    if light.has_direction() {
        ui.label("direction");
        let mut direction = light.direction;
        selected.vector(ui, &mut direction, 0.005, |light| light.direction);
        if direction != light.direction
            && let Some(unit) = direction.try_normalize()
        {
            light.direction = unit;
        }
        ui.end_row();
    }
}

fn cone(ui: &mut Ui, selected: &Selected, light: &mut Light) {
    if !selected.all_have(&[LightKind::Spot]) {
        return;
    }
    for (text, outer) in [("cone", true), ("inner", false)] {
        ui.label(text);
        let of = |light: &Light| if outer { light.outer_angle } else { light.inner_angle }.to_degrees();
        let before = of(light);
        let mut deg = before;
        let most = if outer { 90.0 } else { light.outer_angle.to_degrees() };
        ui.add(selected.number(&mut deg, of).speed(0.1).range(0.0..=most).max_decimals(2).suffix("°"));
        if deg != before {
            *(if outer { &mut light.outer_angle } else { &mut light.inner_angle }) = deg.to_radians();
            light.inner_angle = light.inner_angle.min(light.outer_angle);
        }
        ui.end_row();
    }
}

fn size(ui: &mut Ui, selected: &Selected, light: &mut Light, step: f64, keeps: &mut SizeKeeps) {
    use LightKind::{Directional, Disk, Dome, Point, Rect, Spot};
    let mut keep_radiance = |ui: &mut Ui| {
        let mut radiance = *keeps == SizeKeeps::Radiance;
        let shown = ui.checkbox(&mut radiance, "keep nit");
        shown.on_hover_text("a change of size keeps the radiance (nit); else it keeps the power");
        *keeps = if radiance { SizeKeeps::Radiance } else { SizeKeeps::Power };
    };
    fn length(field: DragValue<'_>, step: f64) -> DragValue<'_> {
        field.speed(step * 0.01).range(0.0..=1e12).max_decimals(4).suffix(" m")
    }
    if selected.all_have(&[Point, Spot, Disk]) {
        ui.label("radius");
        ui.horizontal(|ui| {
            ui.add(length(selected.number(&mut light.radius, |light| light.radius), step));
            if light.kind != Spot {
                keep_radiance(ui);
            }
        });
        ui.end_row();
    }
    if selected.all_have(&[Rect]) {
        ui.label("size");
        ui.horizontal(|ui| {
            for side in 0..2 {
                ui.add(length(selected.number(&mut light.size[side], |light| light.size[side]), step));
            }
            keep_radiance(ui);
        });
        ui.end_row();
    }
    let mut angle = |ui: &mut Ui, of: fn(&mut Light) -> &mut f64, most: std::ops::RangeInclusive<f64>| {
        let before = of(light).to_degrees();
        let mut deg = before;
        let field = selected.number(&mut deg, |light| of(&mut light.clone()).to_degrees());
        ui.add(field.range(most).speed(0.1).max_decimals(2).suffix("°"));
        if deg != before {
            *of(light) = deg.to_radians();
        }
    };
    if selected.all_have(&[Dome]) {
        ui.label("turned");
        angle(ui, |light| &mut light.rotation, -720.0..=720.0);
        ui.end_row();
    }
    if selected.all_have(&[Directional]) {
        ui.label("angle");
        ui.horizontal(|ui| {
            angle(ui, |light| &mut light.angle, 0.0..=180.0);
            keep_radiance(ui);
        });
        ui.end_row();
    }
    if selected.all_have(&[Disk, Rect]) {
        ui.label("spread");
        angle(ui, |light| &mut light.spread, 0.01..=180.0);
        ui.end_row();
        ui.label("");
        selected.switch(ui, &mut light.two_sided, "two sides", |light| light.two_sided);
        ui.end_row();
    }
}

fn physical_sky(ui: &mut Ui, selected: &Selected, light: &mut Light) {
    if !selected.all_have(&[LightKind::Dome]) {
        return;
    }
    let of = |light: &Light| light.map.as_ref().and_then(DomeMap::as_physical).copied();
    let before = of(light);
    let mut is_physical = before.is_some();
    ui.label("sky");
    selected.switch(ui, &mut is_physical, "physical", |light| of(light).is_some());
    ui.end_row();
    if is_physical != before.is_some() {
        light.map = is_physical.then(|| DomeMap::physical(PhysicalSky::default()));
    }
    let Some(before) = of(light) else { return };
    let mut sky = before;
    ui.label("sun");
    ui.horizontal(|ui| {
        let mut deg = before.elevation.to_degrees();
        let field = selected.number(&mut deg, |light| of(light).map_or(0.0, |sky| sky.elevation));
        let shown = ui.add(field.speed(0.1).range(0.0..=90.0).max_decimals(2).suffix("°"));
        if shown.on_hover_text("above the horizon").changed() {
            sky.elevation = deg.to_radians();
        }
        selected.switch(ui, &mut sky.sun, "disk", |light| of(light).is_some_and(|sky| sky.sun));
    });
    ui.end_row();
    ui.label("turbidity");
    let field = selected.number(&mut sky.turbidity, |light| of(light).map_or(0.0, |sky| sky.turbidity));
    let shown = ui.add(field.speed(0.02).range(TURBIDITY).max_decimals(2));
    shown.on_hover_text("haze: 2 is a clear day, 6 a hazy one");
    ui.end_row();
    ui.label("ground");
    let field = selected.number(&mut sky.ground, |light| of(light).map_or(0.0, |sky| sky.ground));
    let shown = ui.add(field.speed(0.005).range(0.0..=1.0).max_decimals(3));
    shown.on_hover_text("share of light that the ground reflects");
    ui.end_row();
    if sky != before {
        light.map = Some(DomeMap::physical(sky));
    }
}

fn range(ui: &mut Ui, selected: &Selected, light: &mut Light, step: f64) {
    ui.label("range");
    ui.horizontal(|ui| {
        let mut limited = light.range.is_some();
        selected.switch(ui, &mut limited, "", |light| light.range.is_some());
        let mut range = light.range.unwrap_or(100.0 * step);
        if limited {
            let field = selected.number(&mut range, |light| light.range.unwrap_or(0.0));
            ui.add(field.speed(step * 0.1).range(1e-6..=1e12).max_decimals(3).suffix(" m"));
        }
        light.range = limited.then_some(range);
    });
    ui.end_row();
}

/// Draws the group of the selected lights, and the values of the primary light's group.
fn group_values(ui: &mut Ui, desk: &mut Desk) {
    ui.separator();
    let primary_group = desk.group();
    let is_mixed = desk.selection().iter().any(|light| desk.rig().lights[light].group != primary_group);
    let shown = match primary_group {
        _ if is_mixed => "mixed",
        Some(group) => &desk.rig().groups[group].name,
        None => "none",
    };
    let mut chosen = None;
    ui.horizontal(|ui| {
        ui.label("group");
        egui::ComboBox::from_id_salt("group").selected_text(shown).show_ui(ui, |ui| {
            let groups = desk.rig().groups.iter().enumerate().map(|(i, group)| (Some(i), group.name.as_str()));
            for (group, name) in [(None, "none")].into_iter().chain(groups) {
                if ui.selectable_label(group == primary_group && !is_mixed, name).clicked() {
                    chosen = Some(group);
                }
            }
        });
    });
    if let Some(group) = chosen {
        desk.set_group(group);
    }
    let Some(index) = desk.group() else { return };
    let mut group: LightGroup = desk.rig().groups[index].clone();
    Grid::new("group values").num_columns(2).spacing([8.0, 4.0]).show(ui, |ui| {
        ui.label("name");
        name(ui, &mut group.name);
        ui.end_row();
        ui.label("master");
        ui.horizontal(|ui| {
            let field = DragValue::new(&mut group.stops).speed(0.02).range(-60.0..=60.0).max_decimals(2);
            ui.add(field.suffix(" stops"));
            ui.checkbox(&mut group.enabled, "on");
            ui.checkbox(&mut group.solo, "solo");
        });
        ui.end_row();
        ui.label("tint");
        ui.horizontal(|ui| {
            let mut color = color_button(ui, group.color);
            for channel in &mut color {
                ui.add(DragValue::new(channel).speed(0.005).range(0.0..=1e6).max_decimals(3));
            }
            group.color = Vec3::from_array(color);
        });
        ui.end_row();
    });
    desk.replace_group(index, group);
}

/// Draws which light the primary light follows.
fn follow_values(ui: &mut Ui, desk: &mut Desk) {
    let Some(leader) = desk.selected_light().and_then(|light| light.follows) else { return };
    ui.horizontal(|ui| {
        ui.label(format!("follows {}", desk.rig().lights[leader].name));
        if ui.button("unfollow").clicked() {
            desk.unfollow();
        }
    });
}
