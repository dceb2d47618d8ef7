//! Which images a picture needs, and how those that are not valid are made.

use glam::Vec3;

use super::limit::{Advances, Limit};
use super::plan::{Detail, Plan, Source, Step, Term};
use super::{BATCH, LightCache, Node};
use crate::scene::LightKind;

impl LightCache {
    /// Plans the whole picture. Outside of the focus it shades about `most` points of lights: as long as all images are
    /// being made, it begins so many of them and lacks further lights, and then gives points to images of lights with a
    /// size, unless lights were edited. Later pictures go on. Images that edits invalidate have no such limit.
    pub fn plan(&mut self, most: usize) -> Plan {
        self.clock += 1;
        if self.detail != Detail::Coarse {
            self.release_coarse();
        }
        self.stop_comparing_dark();
        let mut plan = Plan::default();
        let mut edited = std::mem::take(&mut self.edited);
        let is_edited = !edited.is_empty();
        edited.sort_unstable();
        edited.dedup();
        match self.selected.take() {
            Some(selected) => {
                let is_inside = |n| selected.binary_search(&n).is_ok() || self.has_ancestor_in(n, &selected);
                if self.focus != selected || !edited.iter().all(|&n| is_inside(n)) {
                    self.rest = None;
                }
                self.focus = selected;
                self.edited_before.clone_from(&self.focus);
            }
            None => self.focus_on(edited),
        }
        let mut focus_terms = Vec::new();
        let mut rest_nodes = Vec::new();
        if let Some(root) = self.root {
            self.split(root, Vec3::ONE, &mut focus_terms, &mut rest_nodes);
        }
        let mut pinned = Vec::new();
        let mut is_coarse = false;
        if self.rest_is_coarse && self.detail != Detail::Coarse {
            self.rest = None;
        }
        let of_focus = self.advances(&focus_terms, &Limit::none());
        let of_rest = match self.rest {
            Some(_) => Advances::default(),
            None => self.advances(&rest_nodes, &self.limit(most, is_edited)),
        };
        of_focus.leaves().chain(of_rest.leaves()).for_each(|leaf| self.release_above(leaf));
        for (node, scale) in focus_terms {
            let (slot, _) = self.ensure_image(node, &of_focus, &mut plan.steps);
            let slot = slot.expect("nothing in the focus is lacking");
            is_coarse |= self.nodes[node].coarse;
            self.slots.pin(slot);
            pinned.push(slot);
            plan.picture.push(Term { source: Source::Slot(slot), scale });
        }
        let before_rest = plan.steps.len();
        let rest = match self.rest.take() {
            Some(rest) => rest,
            None => self.make_rest(&rest_nodes, &of_rest, &mut plan.steps),
        };
        let shades = plan.steps[before_rest..].iter().filter_map(Step::as_shade);
        self.points_in_rest = shades.map(|shade| shade.points.count()).sum();
        self.was_whole |= self.lacking == 0;
        plan.picture.extend(&rest);
        self.rest = Some(rest);
        for slot in pinned {
            self.slots.unpin(slot);
        }
        self.picture_is_coarse = is_coarse || self.rest_is_coarse;
        plan
    }

    /// Plans the picture of one light alone.
    pub fn plan_light(&mut self, light: usize) -> Plan {
        self.compared = self.compared.filter(|&compared| compared == self.leaf_of[light]);
        self.plan_light_beside_others(light)
    }

    fn plan_light_beside_others(&mut self, light: usize) -> Plan {
        self.clock += 1;
        let mut plan = Plan::default();
        let mut scale = Vec3::ONE;
        let mut node = Some(self.leaf_of[light]);
        while let Some(n) = node {
            scale *= self.scale(n);
            node = self.nodes[n].parent;
        }
        (self.picture_is_coarse, self.lacking, self.points_in_rest) = (false, 0, 0);
        if scale != Vec3::ZERO {
            let most = self.steps_of_each();
            let slot = self.ensure_leaf(self.leaf_of[light], light, most, &mut plan.steps);
            self.release_coarse_above(self.leaf_of[light]);
            self.picture_is_coarse = self.nodes[self.leaf_of[light]].coarse;
            plan.picture.push(Term { source: Source::Slot(slot), scale });
        }
        plan
    }

    /// Plans a part of the image of one light: all of it if the light has no size, else at most `most` times some of
    /// its points.
    pub fn plan_part(&mut self, light: usize, most: u32) -> Plan {
        self.clock += 1;
        self.compared = self.compared.filter(|&compared| compared == self.leaf_of[light]);
        let mut plan = Plan::default();
        self.add_points(self.leaf_of[light], light, most, &mut plan.steps);
        self.release_coarse_above(self.leaf_of[light]);
        plan
    }

    /// Plans a contact sheet of `cells` cells, one light's contribution per cell.
    pub fn plan_sheet(&mut self, cells: usize) -> Plan {
        self.stop_comparing_dark();
        (self.lacking, self.points_in_rest) = (0, 0);
        let mut plan = Plan::default();
        let mut is_coarse = false;
        for cell in 0..cells {
            let light =
                if cell < self.rig.lights.len() { self.plan_light_beside_others(cell) } else { Plan::default() };
            is_coarse |= self.picture_is_coarse;
            plan.steps.extend(light.steps);
            plan.steps.push(Step::Show { cell, term: light.picture.first().copied() });
        }
        self.picture_is_coarse = is_coarse;
        plan
    }

    /// Splits the tree into focus nodes and the largest subtrees without focus nodes, each with its scale in the
    /// picture.
    fn split(
        &self,
        node: usize,
        above: Vec3,
        focus_terms: &mut Vec<(usize, Vec3)>,
        rest_nodes: &mut Vec<(usize, Vec3)>,
    ) {
        let scale = above * self.scale(node);
        if self.focus.contains(&node) {
            if scale != Vec3::ZERO {
                focus_terms.push((node, scale));
            }
        } else if !self.focus.iter().any(|&f| self.is_below(f, node)) {
            rest_nodes.push((node, scale));
        } else if let Some(children) = self.nodes[node].children {
            for child in children {
                self.split(child, scale, focus_terms, rest_nodes);
            }
        }
    }

    /// Plans the picture of all emitters together.
    pub fn plan_emitters(&mut self) -> Plan {
        self.clock += 1;
        let mut plan = Plan::default();
        let is_emitter = |light: &usize| self.rig.lights[*light].kind == LightKind::Emitter;
        let emitters = (0..self.rig.lights.len()).filter(is_emitter);
        let nodes: Vec<_> = emitters.map(|light| (self.leaf_of[light], self.rig.scale(light))).collect();
        plan.picture = self.make_rest(&nodes, &Advances::default(), &mut plan.steps);
        (self.rest, self.points_in_rest) = (None, 0);
        self.picture_is_coarse = self.rest_is_coarse;
        plan
    }

    /// Plans the rest, the sum of `nodes`; returns its terms. `advances`: see [`Self::ensure_image`].
    fn make_rest(&mut self, nodes: &[(usize, Vec3)], advances: &Advances, steps: &mut Vec<Step>) -> Vec<Term> {
        (self.rest_is_coarse, self.lacking) = (false, 0);
        let mut slots = Vec::new();
        let mut kept = 0.0;
        let mut nodes = nodes.iter().filter(|(_, scale)| *scale != Vec3::ZERO).peekable();
        while let Some(&(node, scale)) = nodes.next() {
            let (slot, lacking) = self.ensure_image(node, advances, steps);
            self.lacking += lacking;
            self.rest_is_coarse |= lacking > 0;
            if let Some(slot) = slot {
                self.rest_is_coarse |= self.nodes[node].coarse;
                self.slots.pin(slot);
                slots.push((slot, scale));
            }
            if slots.len() == BATCH || (nodes.peek().is_none() && !slots.is_empty()) {
                slots.iter().for_each(|(slot, _)| self.slots.unpin(*slot));
                let terms = slots.drain(..).map(|(slot, scale)| Term { source: Source::Slot(slot), scale }).collect();
                steps.push(Step::Sum { target: Source::Rest, terms, kept });
                kept = 1.0;
            }
        }
        let rest = Term { source: Source::Rest, scale: Vec3::ONE };
        if kept > 0.0 { vec![rest] } else { Vec::new() }
    }

    /// Plans `node`'s image unless it is valid. Only the leaves of `advances` get images or more points. Returns its
    /// slot, or `None` if no light below the node has an image, and the number of lights that lack one.
    fn ensure_image(&mut self, node: usize, advances: &Advances, steps: &mut Vec<Step>) -> (Option<usize>, usize) {
        let Node { slot, changed, children, light, lacking, .. } = self.nodes[node];
        if let Some(light) = light {
            let is_emitter = self.rig.lights[light].kind == LightKind::Emitter;
            let most = advances.of(node, slot.is_some());
            if changed.is_none() && !self.nodes[node].is_complete() && !is_emitter && most.is_none() {
                slot.inspect(|&slot| self.slots.use_at(slot, self.clock));
                return (slot, usize::from(slot.is_none()));
            }
            return (Some(self.ensure_leaf(node, light, most.unwrap_or(0), steps)), 0);
        }
        if let Some(slot) = slot {
            self.slots.use_at(slot, self.clock);
            return (Some(slot), lacking);
        }
        let children = children.expect("a node without light has children");
        let mut terms = Vec::with_capacity(2);
        let (mut coarse, mut lacking) = (false, 0);
        for child in children {
            let scale = self.scale(child);
            if scale != Vec3::ZERO {
                let (slot, lacking_below) = self.ensure_image(child, advances, steps);
                lacking += lacking_below;
                let Some(slot) = slot else { continue };
                coarse |= self.nodes[child].coarse;
                self.slots.pin(slot);
                terms.push((slot, scale));
            }
        }
        if lacking > 0 && terms.is_empty() {
            return (None, lacking);
        }
        let target = self.take_slot(node);
        (self.nodes[node].coarse, self.nodes[node].lacking) = (coarse || lacking > 0, lacking);
        for (slot, _) in &terms {
            self.slots.unpin(*slot);
        }
        let terms = terms.into_iter().map(|(slot, scale)| Term { source: Source::Slot(slot), scale }).collect();
        steps.push(Step::Sum { target: Source::Slot(target), terms, kept: 0.0 });
        (Some(target), lacking)
    }
}
