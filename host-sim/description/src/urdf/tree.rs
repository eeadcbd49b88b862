//! The tree of links: which path is the arm, and what moves as one body.

use super::document::{Document, no_robot};
use super::{Assumed, Selection};
use crate::robot::{Link, Placement};
use nalgebra::{Matrix3, Vector3};

/// Links and joints by index, with the links of every joint and the joints of every link.
pub(super) struct Tree<'a> {
    document: &'a Document,
    parent: Vec<usize>,
    /// The link that each joint moves.
    pub(super) child: Vec<usize>,
    carried: Vec<Vec<usize>>,
    carrier: Vec<Option<usize>>,
    /// Moving joints taken as fixed ones.
    welded: Vec<bool>,
}

impl<'a> Tree<'a> {
    pub(super) fn of(document: &'a Document) -> Result<Self, String> {
        let count = document.links.len();
        let mut tree = Self {
            document,
            parent: Vec::new(),
            child: Vec::new(),
            carried: vec![Vec::new(); count],
            carrier: vec![None; count],
            welded: vec![false; document.joints.len()],
        };
        for (index, joint) in document.joints.iter().enumerate() {
            let named_by = format!("joint '{}'", joint.name);
            let child = tree.link(&joint.child);
            let parent = tree.link(&joint.parent).ok_or_else(|| {
                let name = &joint.child;
                let mend = child.map(|_| format!(" (--base '{name}' begins the arm behind it)"));
                unknown_link(&joint.parent, &named_by, &mend.unwrap_or_default())
            })?;
            let child = child.ok_or_else(|| unknown_link(&joint.child, &named_by, ""))?;
            tree.parent.push(parent);
            tree.child.push(child);
            tree.carried[parent].push(index);
            if tree.carrier[child].replace(index).is_some() {
                return Err(not_a_tree(&joint.child));
            }
        }
        // One parent each: whoever has more ancestors than there are links stands on a loop.
        for start in 0..count {
            let ancestors = std::iter::successors(Some(start), |&link| tree.below(link));
            if ancestors.take(count + 1).count() > count {
                return Err(not_a_tree(&document.links[start].name));
            }
        }
        Ok(tree)
    }

    fn link(&self, name: &str) -> Option<usize> {
        let mut links = self.document.links.iter();
        links.position(|link| link.name == name)
    }

    fn name(&self, link: usize) -> &str {
        &self.document.links[link].name
    }

    /// The link that carries this one.
    fn below(&self, link: usize) -> Option<usize> {
        self.carrier[link].map(|joint| self.parent[joint])
    }

    pub(super) fn is_fixed(&self, joint: usize) -> bool {
        self.welded[joint] || self.document.joints[joint].kind == "fixed"
    }

    /// Takes every moving joint beside `path` as fixed.
    pub(super) fn weld(&mut self, path: &[usize]) {
        for joint in (0..self.welded.len()).filter(|joint| !path.contains(joint)) {
            self.welded[joint] = true;
        }
    }

    /// The link called `name`, or the one that the joint of that name moves (with `parent`: leaves).
    pub(super) fn link_or_joint(
        &self,
        name: &str,
        named_by: &str,
        parent: bool,
    ) -> Result<usize, String> {
        let mut joints = self.document.joints.iter();
        let joint = joints.position(|joint| joint.name == name);
        let links = if parent { &self.parent } else { &self.child };
        let link = self.link(name).or(joint.map(|joint| links[joint]));
        link.ok_or_else(|| unknown_link(name, named_by, &self.near(name)))
    }

    /// Question for the links and joints with the names nearest to `name`; empty where none is near.
    fn near(&self, name: &str) -> String {
        let (links, joints) = (&self.document.links, &self.document.joints);
        let links = links.iter().map(|link| &link.name);
        let names = links.chain(joints.iter().map(|joint| &joint.name));
        let wanted = name.to_lowercase();
        let likeness = |name: &String| strsim::jaro_winkler(&wanted, &name.to_lowercase());
        let mut near: Vec<(f64, &String)> = names
            .map(|name| (likeness(name), name))
            .filter(|(likeness, _)| *likeness > 0.8)
            .collect();
        // A link and a joint may have one name.
        near.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(b.1)));
        near.dedup();
        near.truncate(3);
        let near: Vec<&str> = near.iter().map(|(_, name)| name.as_str()).collect();
        match near[..] {
            [] => String::new(),
            _ => format!(" (did you mean '{}'?)", near.join("' or '")),
        }
    }

    pub(super) fn base(&self, selection: &Selection<'_>) -> Result<usize, String> {
        if let Some(name) = selection.base {
            return self.link_or_joint(name, "--base", true);
        }
        let mut roots = (0..self.carrier.len()).filter(|&link| self.carrier[link].is_none());
        match (roots.next(), roots.next()) {
            (Some(root), None) => Ok(root),
            (Some(first), Some(second)) => {
                let roots = [first, second].into_iter().chain(roots);
                let roots: Vec<&str> = roots.map(|link| self.name(link)).collect();
                let roots = roots.join("', '");
                Err(format!(
                    "links '{roots}' have no parent: choose one with --base"
                ))
            }
            (None, _) => Err(no_robot("no links")),
        }
    }

    /// Frame of the root in that of a link, with every joint between them at zero.
    pub(super) fn root_in(&self, link: usize) -> Placement {
        let carriers = std::iter::successors(self.carrier[link], |&joint| {
            self.carrier[self.parent[joint]]
        });
        let origins = carriers.map(|joint| self.document.joints[joint].origin);
        let link_in_root = origins.fold(Placement::identity(), |link, origin| origin.then(&link));
        link_in_root.snapped().inverse()
    }

    /// Joints from base to tip.
    pub(super) fn path_to(&self, base: usize, tip: usize) -> Result<Vec<usize>, String> {
        let mut path = Vec::new();
        let mut link = tip;
        while link != base {
            let Some(joint) = self.carrier[link] else {
                let (base, tip) = (self.name(base), self.name(tip));
                return Err(format!("link '{tip}' is not carried by link '{base}'"));
            };
            path.push(joint);
            link = self.parent[joint];
        }
        path.reverse();
        Ok(path)
    }

    fn turns(&self, joint: usize) -> bool {
        let element = &self.document.joints[joint];
        matches!(element.kind.as_str(), "revolute" | "continuous") && !element.mimic
    }

    /// Turning joints of their own on the longest path that begins with `joint`.
    fn reach(&self, joint: usize) -> usize {
        let next = self.carried[self.child[joint]].iter();
        usize::from(self.turns(joint)) + next.map(|&joint| self.reach(joint)).max().unwrap_or(0)
    }

    /// The last link on the longest path that begins with `joint`, before fingers.
    fn farthest(&self, joint: usize) -> usize {
        let body = self.rigid_body(self.child[joint], Placement::identity());
        let at_fork = self.moving_joints(&body).count() > 1;
        let next = self.carried[self.child[joint]].iter().copied();
        let next = next.filter(|&joint| self.reach(joint) > 0);
        let next = next.filter(|&joint| self.is_fixed(joint) || !self.is_finger(joint, at_fork));
        next.max_by_key(|&joint| self.reach(joint))
            .map_or(self.child[joint], |joint| self.farthest(joint))
    }

    /// A finger by its name, called like a part of a gripper: the last joint of a branch, or at a fork a chain of such joints.
    /// A single one that carries another is the wrist under a gripper.
    fn is_finger(&self, joint: usize, at_fork: bool) -> bool {
        let element = &self.document.joints[joint];
        let names = [&element.name, &element.child].map(|name| name.to_lowercase());
        let is_called = ["grip", "jaw", "finger", "claw", "knuckle", "thumb"]
            .iter()
            .any(|word| names.iter().any(|name| name.contains(word)));
        let body = self.rigid_body(self.child[joint], Placement::identity());
        let beyond: Vec<usize> = self.moving_joints(&body).collect();
        let is_chain = || beyond.len() == 1 && self.is_finger(beyond[0], true);
        is_called && (beyond.is_empty() || at_fork && is_chain())
    }

    /// Joints from base to the link where everything beyond is fixed, prismatic, mimic or fingers.
    pub(super) fn only_path(&self, base: usize) -> Result<Vec<usize>, String> {
        let mut end = base;
        loop {
            let [moving, mut on] = self.onward(base, end);
            match on[..] {
                // Nothing but a joint that no arm can have: its refusal names it.
                [] if end == base && moving.len() == 1 => end = self.child[moving[0]],
                [] if moving.is_empty() => break,
                [] => return self.path_to(base, self.parent[moving[0]]),
                [joint] => end = self.child[joint],
                _ => {
                    on.sort_by_key(|&joint| std::cmp::Reverse(self.reach(joint)));
                    let tips = on.iter().flat_map(|&joint| self.tips(base, joint));
                    let mut tips = tips
                        .map(|tip| self.tip_option(base, tip))
                        .collect::<Result<Vec<_>, _>>()?;
                    let mut mend = "";
                    if tips.iter().any(|(_, loses)| *loses) {
                        if self.path_to(base, end)?.iter().any(|&j| self.turns(j)) {
                            tips.push(self.tip_option(base, end)?);
                        }
                        mend = "; --weld leaves nothing out";
                    }
                    let tips: Vec<String> = tips.into_iter().map(|(option, _)| option).collect();
                    let tips = tips.join(" or ");
                    let link = self.name(end);
                    return Err(format!(
                        "the tree branches at link '{link}': choose the arm's end with {tips}{mend}"
                    ));
                }
            }
        }
        // A chain of fixed joints at the end leads to the flange; a fork of them does not.
        while let [joint] = self.carried[end][..] {
            end = self.child[joint];
        }
        self.path_to(base, end)
    }

    /// The option for a tip, and whether the arm loses mass by it.
    fn tip_option(&self, base: usize, tip: usize) -> Result<(String, bool), String> {
        let beside = self.beside(base, &self.path_to(base, tip)?);
        let lost: f64 = beside.iter().map(|(_, lost)| lost).sum();
        let option = format!("--tip '{}'", self.name(tip));
        Ok(match lost > 5e-4 {
            true => (format!("{option} (leaves out {lost:.3} kg)"), true),
            false => (option, false),
        })
    }

    /// Joints that move what the body of link `end` carries, and those of them that lead on to an arm.
    fn onward(&self, base: usize, end: usize) -> [Vec<usize>; 2] {
        let body = self.rigid_body(end, Placement::identity());
        let moving: Vec<usize> = self.moving_joints(&body).collect();
        let fork = moving.len() > 1;
        let mut on = moving.clone();
        on.retain(|&joint| self.reach(joint) > usize::from(fork));
        on.retain(|&joint| end == base || !self.is_finger(joint, fork));
        [moving, on]
    }

    /// Ends of the arms beyond a joint.
    fn tips(&self, base: usize, joint: usize) -> Vec<usize> {
        let [_, on] = self.onward(base, self.child[joint]);
        match on[..] {
            [] => vec![self.farthest(joint)],
            _ => on.iter().flat_map(|&on| self.tips(base, on)).collect(),
        }
    }

    /// Links that move as one with `link`, which lies at `frame`.
    fn rigid_body(&self, link: usize, frame: Placement) -> Vec<(usize, Placement)> {
        let mut body = vec![(link, frame)];
        let mut next = 0;
        while let Some(&(link, frame)) = body.get(next) {
            next += 1;
            let carried = self.carried[link].iter();
            for &joint in carried.filter(|&&joint| self.is_fixed(joint)) {
                let origin = &self.document.joints[joint].origin;
                body.push((self.child[joint], frame.then(origin)));
            }
        }
        body
    }

    fn moving_joints(&self, body: &[(usize, Placement)]) -> impl Iterator<Item = usize> {
        body.iter()
            .flat_map(|&(link, _)| self.carried[link].iter().copied())
            .filter(|&joint| !self.is_fixed(joint))
    }

    /// One link for everything that joint `joint` moves as one body.
    ///
    /// * `own` gets the names of values that the file does not give
    pub(super) fn lumped(
        &self,
        joint: usize,
        frame: &Placement,
        selection: &Selection<'_>,
        own: &mut Assumed,
        notes: &mut Vec<String>,
    ) -> Result<Link, String> {
        let moved = self.child[joint];
        let of_link = |link: usize, text: String| format!("link '{}': {text}", self.name(link));
        let inertia_reason = |link: &Link| {
            let problem = Link::inertia_problem(&link.inertia_com)?;
            Some(format!(
                "inertia {problem} (--repair takes the nearest of a body)"
            ))
        };
        let mut parts = Vec::new();
        for (link, frame) in self.rigid_body(moved, *frame) {
            let Some(mut part) = self.document.links[link].inertial else {
                continue;
            };
            // A sensor bolted on may be given as a point of mass; the body as a whole may not.
            let is_point = link != moved && part.inertia_com == Matrix3::zeros();
            if selection.repair && part.mass == 0.0 {
                notes.push(of_link(link, "inertia without mass is left out".to_owned()));
                continue;
            }
            if selection.repair && part.mass > 0.0 && !is_point && inertia_reason(&part).is_some() {
                let (repaired, change) = part.repaired();
                let repair = "inertia moved to the nearest of a body, by";
                notes.push(of_link(link, format!("{repair} {change:.2e} kg·m²")));
                part = repaired;
            }
            let reason = if part.mass == 0.0 {
                Some("mass is 0, must be positive (--repair leaves it out)".to_owned())
            } else if part.mass < 0.0 {
                Some(format!("mass is {}, must be positive", part.mass))
            } else if is_point {
                None
            } else {
                inertia_reason(&part)
            };
            if let Some(reason) = reason {
                return Err(of_link(link, reason));
            }
            parts.push(part.placed(&frame));
        }
        if let (true, Some(mass)) = (parts.is_empty(), selection.link_mass) {
            let next = self.carried[moved].first();
            let end = next.map_or(Vector3::new(0.0, 0.0, 0.1), |&joint| {
                self.document.joints[joint].origin.origin
            });
            own.fields.extend(["mass_kg", "com_m", "inertia_kg_m2"]);
            parts.push(Link::rod(mass, &end).placed(frame));
        }
        let body = Link::lumped(&parts).ok_or_else(|| {
            let (link, joint) = (self.name(moved), &self.document.joints[joint].name);
            format!(
                "link '{link}' is moved by joint '{joint}' but has no inertial data: give such links a mass with --link-mass"
            )
        })?;
        match inertia_reason(&body) {
            // Of points alone.
            Some(_) if selection.repair => {
                let (repaired, change) = body.repaired();
                let repair = "inertia of all its parts moved to the nearest of a body, by";
                notes.push(of_link(moved, format!("{repair} {change:.2e} kg·m²")));
                Ok(repaired)
            }
            Some(reason) => Err(of_link(moved, reason)),
            None => Ok(body),
        }
    }

    /// Mass of a link and of all that it carries, kg; with `bolted` of what fixed joints carry alone.
    fn mass(&self, link: usize, bolted: bool) -> f64 {
        let own = self.document.links[link].inertial.map_or(0.0, |i| i.mass);
        let carried = self.carried[link].iter();
        let carried = carried.filter(|&&joint| !bolted || self.is_fixed(joint));
        own + carried
            .map(|&j| self.mass(self.child[j], bolted))
            .sum::<f64>()
    }

    /// Moving joints beside the path, and the mass that the arm loses with each, kg: none with those on its base.
    fn beside(&self, base: usize, path: &[usize]) -> Vec<(usize, f64)> {
        let moved = path.iter().filter(|&&joint| !self.is_fixed(joint));
        let links = std::iter::once(base).chain(moved.map(|&joint| self.child[joint]));
        let beside = links.flat_map(|link| {
            let body = self.rigid_body(link, Placement::identity());
            let beside = self.moving_joints(&body).filter(|j| !path.contains(j));
            let lost = |joint| match link == base {
                true => 0.0,
                false => self.mass(self.child[joint], false),
            };
            beside.map(|j| (j, lost(j))).collect::<Vec<_>>()
        });
        beside.collect()
    }

    /// Description of the parts that do not belong to the arm.
    pub(super) fn left_out(&self, base: usize, path: &[usize]) -> Vec<String> {
        let beside = self.beside(base, path).into_iter().map(|(joint, lost)| {
            let joint = &self.document.joints[joint];
            let lost = match lost {
                0.0 => String::new(),
                _ => format!(", {lost:.3} kg (--weld keeps it)"),
            };
            let (link, joint) = (&joint.child, &joint.name);
            format!("left out: link '{link}' on joint '{joint}' and all it carries{lost}")
        });
        beside.collect()
    }

    /// Description of what belongs to the arm behind its tip, if that has a mass.
    pub(super) fn bolted_behind(&self, tip: usize) -> Option<String> {
        let own = self.document.links[tip].inertial.map_or(0.0, |i| i.mass);
        let (behind, link) = (self.mass(tip, true) - own, self.name(tip));
        (behind > 0.0).then(|| format!(
            "link '{link}' carries {behind:.3} kg on fixed joints, part of the arm: take out of the file what the arm does not have"
        ))
    }
}

fn unknown_link(link: &str, named_by: &str, mend: &str) -> String {
    format!("{named_by} names '{link}', which is neither a link nor a joint{mend}")
}

fn not_a_tree(link: &str) -> String {
    format!("link '{link}' closes a loop or has two parents, only a tree is an arm")
}
