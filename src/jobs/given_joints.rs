//! The joints that a request brings with it, by a skeleton or in the file, and what it says of them: which must not deform, and
//! which keep their weights.

use super::failure::{ErrorCode, JobError};
use super::joint_pattern::matches;
use super::options::{ExistingRigPolicy, RigOptions};
use crate::formats::Asset;
use crate::pipelines::{Given, Skeleton};
use crate::rig::Influence;
use crate::rig::locked_weights::Locks;
use std::borrow::Cow;

/// A skeleton to weigh over, with every name in the request resolved.
pub(super) struct GivenJoints<'a> {
    pub(super) skeleton: &'a Skeleton,
    deforms: Vec<bool>,
    locked: Option<Locked<'a>>,
}

/// [`Locks`] with what they refer to.
struct Locked<'a> {
    joints: Vec<bool>,
    rows: Cow<'a, [Vec<Influence>]>,
}

impl<'a> GivenJoints<'a> {
    /// `None` where a skeleton is to be made.
    pub(super) fn of(options: &'a RigOptions, asset: &'a Asset) -> Result<Option<Self>, JobError> {
        let kept = asset.old_rig.as_ref().filter(|_| options.existing_rig == ExistingRigPolicy::Reskin);
        let (skeleton, mut deforms) = match (&options.skeleton, kept) {
            (Some(given), _) => (&given.skeleton, vec![true; given.skeleton.joints.len()]),
            (None, Some(rig)) => (&rig.skeleton, rig.deforms.clone()),
            (None, None) => {
                let asked = [("non_deforming", &options.non_deforming), ("locked_joints", &options.locked_joints)];
                return match asked.into_iter().find(|(_, patterns)| !patterns.is_empty()) {
                    Some((field, _)) => Err(refused(
                        format!("{field} names joints of a skeleton that is there, but none was sent"),
                        "send a skeleton, or a rigged file with existing_rig=reskin",
                    )),
                    None => Ok(None),
                };
            }
        };
        for joint in named("non_deforming", &options.non_deforming, skeleton)? {
            deforms[joint] = false;
        }
        if !deforms.contains(&true) {
            return Err(refused("non_deforming names every joint".into(), "leave at least one joint to move the mesh"));
        }
        let locked = match options.locked_joints.is_empty() {
            true => None,
            false => Some(locked(options, asset, skeleton, &deforms)?),
        };
        Ok(Some(Self { skeleton, deforms, locked }))
    }

    pub(super) fn given(&self) -> Given<'_> {
        let locks = self.locked.as_ref().map(|locked| Locks { joints: &locked.joints, rows: &locked.rows });
        Given { skeleton: self.skeleton, deforms: Some(&self.deforms), locks }
    }
}

/// Which joints are locked, and the old weights over the joints of `skeleton`.
fn locked<'a>(
    options: &'a RigOptions,
    asset: &'a Asset,
    skeleton: &Skeleton,
    deforms: &[bool],
) -> Result<Locked<'a>, JobError> {
    let of_skeleton = options.skeleton.as_ref().filter(|given| !given.rows.is_empty());
    let (old, rows) = match (of_skeleton, &asset.old_rig) {
        (Some(given), _) => (&given.skeleton, given.rows.as_slice()),
        (None, Some(rig)) if rig.rows.iter().any(|row| !row.is_empty()) => (&rig.skeleton, rig.rows.as_slice()),
        _ => {
            let message = "locked_joints keep the weights that there were, but neither file nor skeleton has any";
            return Err(refused(
                message.into(),
                "send a file with a skin, or a rig.json with its skins as the skeleton",
            ));
        }
    };
    let (found, vertices) = (rows.len(), asset.mesh.positions.len());
    if found != vertices {
        let message = format!("the old weights are of {found} vertices, but the mesh has {vertices}");
        return Err(refused(message, "send the rig.json that was made of this mesh"));
    }
    // A skeleton that came with its weights has them over its own joints.
    let is_own = of_skeleton.is_some() || options.skeleton.is_none();
    let joint_in_skeleton: Vec<Option<u32>> = (old.joints.iter().enumerate())
        .map(|(index, joint)| match is_own {
            true => Some(index),
            false => skeleton.joints.iter().position(|other| other.name == joint.name),
        })
        .map(|index| index.map(|index| index as u32))
        .collect();
    let mut joints = vec![false; skeleton.joints.len()];
    for joint in named("locked_joints", &options.locked_joints, skeleton)? {
        let name = &skeleton.joints[joint].name;
        if !deforms[joint] {
            return Err(refused(
                format!("joint {name:?} cannot be locked: it does not deform"),
                "leave it out of locked_joints or of non_deforming",
            ));
        }
        if !joint_in_skeleton.contains(&Some(joint as u32)) {
            return Err(refused(
                format!("joint {name:?} cannot be locked: the old skin has no joint of that name"),
                "leave it out of locked_joints, or give it the name that it had",
            ));
        }
        joints[joint] = true;
    }
    let rows = if is_own {
        Cow::Borrowed(rows)
    } else {
        let renamed = |influence: &Influence| {
            let joint = joint_in_skeleton.get(influence.joint as usize).copied().flatten()?;
            Some(Influence { joint, ..*influence })
        };
        Cow::Owned(rows.iter().map(|row| row.iter().filter_map(renamed).collect()).collect())
    };
    Ok(Locked { joints, rows })
}

/// Joints that `patterns` name; each must name one.
fn named(field: &str, patterns: &[String], skeleton: &Skeleton) -> Result<Vec<usize>, JobError> {
    let mut joints = Vec::new();
    for pattern in patterns {
        let before = joints.len();
        let all = skeleton.joints.iter().enumerate();
        joints.extend(all.filter(|(_, joint)| matches(pattern, &joint.name)).map(|(index, _)| index));
        if joints.len() == before {
            let names: Vec<&str> = skeleton.joints.iter().take(NAMES_TOLD).map(|joint| joint.name.as_str()).collect();
            let more = if skeleton.joints.len() > NAMES_TOLD { ", …" } else { "" };
            let message = format!("{field}: no joint of the skeleton is called {pattern:?}");
            return Err(refused(message, format!("there are {}{more}", names.join(", "))));
        }
    }
    Ok(joints)
}

/// Enough to see how the joints are called.
const NAMES_TOLD: usize = 40;

fn refused(message: String, hint: impl Into<String>) -> JobError {
    JobError::new(ErrorCode::SkeletonInvalid, message).hint(hint)
}
