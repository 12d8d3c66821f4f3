//! The rig text format of RigNet [Xu et al. 2020].
//!
//! ```text
//! joints <name> <x> <y> <z>                        8 decimals, upload space
//! root <name>
//! skin <vertex> <joint> <weight> [<joint> <weight> …]   one line per vertex of the mesh, 4 decimals
//! hier <parent> <child>                            breadth first
//! ```

use super::Asset;
use super::gltf::{self, JointNames};
use crate::rig::{Influence, Rig};
use std::collections::VecDeque;
use std::fmt::Write;

/// Least weight that four decimals show.
const WEIGHT_MIN: f32 = 0.000_05;

/// Writes `rig`, whose rows are those of the asset's mesh: file vertices in file order, or all parts one after another.
pub fn write(asset: &Asset, rig: &Rig) -> String {
    // A blank within a name would break the line.
    let names = gltf::joint_names(asset, &rig.skeleton, JointNames::Plain);
    let name = |joint: usize| names.get(joint).map_or("", String::as_str);
    let joints = &rig.skeleton.joints;
    let mut text = String::new();
    // Writing to a string cannot fail.
    let mut line = |arguments: std::fmt::Arguments| {
        let _ = text.write_fmt(arguments);
        text.push('\n');
    };
    for (index, joint) in joints.iter().enumerate() {
        let [x, y, z] = joint.position.to_array();
        line(format_args!("joints {} {x:.8} {y:.8} {z:.8}", name(index)));
    }
    if !joints.is_empty() {
        line(format_args!("root {}", name(0)));
    }
    for (vertex, row) in rig.skin.rows.iter().enumerate() {
        let shown: Vec<&Influence> = row.iter().filter(|influence| influence.weight >= WEIGHT_MIN).collect();
        let pairs =
            shown.iter().map(|influence| format!(" {} {:.4}", name(influence.joint as usize), influence.weight));
        line(format_args!("skin {vertex}{}", pairs.collect::<String>()));
    }
    let mut children = vec![Vec::new(); joints.len()];
    for (index, joint) in joints.iter().enumerate() {
        if let Some(of_parent) = joint.parent.and_then(|parent| children.get_mut(parent)) {
            of_parent.push(index);
        }
    }
    let mut next = VecDeque::from_iter((!joints.is_empty()).then_some(0));
    // Parents precede children, so each joint enters once.
    while let Some(parent) = next.pop_front() {
        for &child in &children[parent] {
            line(format_args!("hier {} {}", name(parent), name(child)));
            next.push_back(child);
        }
    }
    text
}
