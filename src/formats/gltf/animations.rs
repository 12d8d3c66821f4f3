//! Animation channels after nodes moved or went: kept, pointed elsewhere, or dropped with what only they used.

use super::buffers::items_mut_if_any;
use super::json::{index, items, remove, text};
use serde_json::{Value, json};

/// What becomes of one channel.
pub(super) enum Channel {
    Keep,
    Drop,
    Retarget(usize),
}

/// Asks `decide` about every channel that targets a node, with the node and the path. Returns how many went.
pub(super) fn rewrite(json: &mut Value, decide: impl Fn(usize, &str) -> Channel) -> usize {
    let mut dropped = 0;
    let mut emptied = Vec::new();
    for (number, animation) in items_mut_if_any(json, "animations").iter_mut().enumerate() {
        let before = items(animation, "channels").len();
        if let Some(channels) = animation.get_mut("channels").and_then(Value::as_array_mut) {
            channels.retain_mut(|channel| is_kept(channel, &decide));
        }
        let after = items(animation, "channels").len();
        dropped += before - after;
        if before > after {
            drop_unused_samplers(animation);
        }
        if before > after && after == 0 {
            emptied.push(number);
        }
    }
    let mut position = 0..;
    if let Some(animations) = json.get_mut("animations").and_then(Value::as_array_mut) {
        animations.retain(|_| position.next().is_none_or(|number: usize| emptied.binary_search(&number).is_err()));
        if animations.is_empty() {
            remove(json, "animations");
        }
    }
    dropped
}

fn is_kept(channel: &mut Value, decide: &impl Fn(usize, &str) -> Channel) -> bool {
    let Some(target) = channel.get_mut("target") else { return true };
    let Some(node) = target.get("node").and_then(index) else { return true };
    match decide(node, text(target, "path")) {
        Channel::Keep => true,
        Channel::Drop => false,
        Channel::Retarget(other) => {
            target["node"] = json!(other);
            true
        }
    }
}

fn drop_unused_samplers(animation: &mut Value) {
    let count = items(animation, "samplers").len();
    let mut is_used = vec![false; count];
    for channel in items(animation, "channels") {
        if let Some(used) = channel.get("sampler").and_then(index).and_then(|sampler| is_used.get_mut(sampler)) {
            *used = true;
        }
    }
    let mut kept = 0;
    let renumbered: Vec<usize> = is_used
        .iter()
        .map(|used| {
            kept += usize::from(*used);
            kept.saturating_sub(1)
        })
        .collect();
    for channel in items_mut_if_any(animation, "channels") {
        if let Some(new) = channel.get("sampler").and_then(index).and_then(|sampler| renumbered.get(sampler)) {
            channel["sampler"] = json!(new);
        }
    }
    let mut position = 0..;
    if let Some(samplers) = animation.get_mut("samplers").and_then(Value::as_array_mut) {
        samplers.retain(|_| position.next().is_none_or(|number: usize| is_used[number]));
    }
}
