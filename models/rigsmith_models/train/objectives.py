"""What each network learns: a batch of characters -> loss. One class per network, all with the same two methods."""

import numpy as np
import torch
import torch.nn.functional as F

from ..data.bones import bone_features, candidate_pairs, nearest_bones, weights_of_nearest_bones
from ..data.heter_graph import LINK_INPUTS, heter_graph
from ..data.sampling import SAMPLINGS, Sampling, padded_joints, shape_batch
from ..rignet.skin import BONES_PER_VERTEX
from .joint_stage import BANDWIDTH_LIMITS, mean_shift_states

NEVER = -1e4  # the logit of what is no choice
FAR = 1e3  # longer than any distance in the normalised frame
JOINT_JITTER = 0.01  # predicted joints are about so far off
EDIT_PROBABILITY = 0.2  # of dropping a joint, and of inserting one on a bone
SHARE_JITTER = 0.03  # the inside share of a jittered bone differs from the cached one
DISTANCE_JITTER = 0.05  # relative, same reason
HARDEST_SHARE = 0.3
SHIFT_WEIGHT, MASK_WEIGHT = 2.0, 0.1  # of the mean-shift and mask losses beside the Chamfer distance
L1_WEIGHT = 1.0  # of HeterSkinNet's L1 distance beside its cross-entropy
SKIN_MASS_MIN = 0.5  # a vertex whose reference weights lie mostly on other bones than its nearest teaches nothing


def chamfer(points: torch.Tensor, joints: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """RigNet, Eq. 2, unsquared, both directions averaged.

    points: (G, N, 3), joints: (G, J, 3), valid: (G, J) -> (G,).
    """
    distance = torch.cdist(points, joints) + FAR * (~valid).unsqueeze(1)
    to_joint = distance.amin(2).mean(1)
    to_point = (distance.amin(1) * valid).sum(1) / valid.sum(1)
    return 0.5 * (to_joint + to_point)


class Objective:
    """``batch``: characters -> tensors. ``loss``: network and tensors -> a number. ``augmented`` off shows every character as it is."""

    def __init__(self, sampling: Sampling = SAMPLINGS["sparse"], augmented: bool = True):
        self.sampling, self.augmented = sampling, augmented

    def shapes(self, characters, rng, device, pose: bool = True, scale: bool = True) -> dict:
        return shape_batch(characters, rng, device, self.sampling, pose and self.augmented, scale and self.augmented)


def balanced_cross_entropy(logit: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    share = mask.mean().clamp(0.02, 0.98)
    weight = torch.where(mask > 0.5, 0.5 / share, 0.5 / (1 - share))
    return F.binary_cross_entropy_with_logits(logit, mask, weight=weight)


class JointPairObjective(Objective):
    """Displacement: Chamfer distance between displaced vertices and reference joints. Attention: binary cross-entropy against the ray
    mask, the two classes weighted to balance in every batch. The two networks share batches, not weights.
    """

    def batch(self, characters, progress, rng, device):
        batch = self.shapes(characters, rng, device)
        mask = np.concatenate([c.attention_mask[kept] for c, kept in zip(characters, batch["kept"])])
        batch["mask"] = torch.from_numpy(mask.astype(np.float32)).to(device)
        batch["joints"], batch["valid"] = padded_joints(batch["joints"], device)
        return batch

    def loss(self, network, batch) -> torch.Tensor:
        displacement, logit = network(*body_of(batch))
        points = (batch["positions"] + displacement.float()).reshape(batch["graph_count"], -1, 3)
        return chamfer(points, batch["joints"], batch["valid"]).mean() + balanced_cross_entropy(logit.float(), batch["mask"])


class JointStageObjective(JointPairObjective):
    """Chamfer of the displaced points + 2 x its mean over the mean-shift states + .1 x the mask's cross-entropy."""

    def loss(self, network, batch) -> torch.Tensor:
        displacement, logit = network(*body_of(batch))
        graphs, logit = batch["graph_count"], logit.float()
        mask_loss = F.binary_cross_entropy_with_logits(logit, batch["mask"])
        with torch.autocast(logit.device.type, enabled=False):
            points = (batch["positions"] + displacement.float()).reshape(graphs, -1, 3)
            bandwidth = network.bandwidth.clamp(*BANDWIDTH_LIMITS)
            states = mean_shift_states(points, torch.sigmoid(logit).reshape(graphs, -1), bandwidth)
            direct = chamfer(points, batch["joints"], batch["valid"]).mean()
            shifted = torch.stack([chamfer(s, batch["joints"], batch["valid"]).mean() for s in states]).mean()
        return direct + SHIFT_WEIGHT * shifted + MASK_WEIGHT * mask_loss


def edited_skeleton(joints, parents, inside_share, rng):
    """Makes a reference skeleton look predicted: jitter, a joint dropped, a joint inserted on a bone.

    joints: (J, 3), parents: (J,), inside_share: (P,) of the pairs i < j -> joints (J', 3), parents (J',), share (J', J').
    """
    count = len(joints)
    share = np.zeros((count, count), np.float32)
    pairs = candidate_pairs(count)
    share[pairs[:, 0], pairs[:, 1]] = inside_share
    share += share.T
    joints, parents = joints.copy(), parents.astype(int).copy()
    if rng.random() < EDIT_PROBABILITY and count > 4:
        victim = int(rng.integers(1, count))
        parents[parents == victim] = parents[victim]
        keep = np.arange(count) != victim
        renumber = np.cumsum(keep) - 1
        joints, share = joints[keep], share[np.ix_(keep, keep)]
        parents = np.where(parents[keep] < 0, -1, renumber[parents[keep]])
    if rng.random() < EDIT_PROBABILITY:
        child = int(rng.integers(1, len(joints)))
        parent, part = parents[child], rng.uniform(0.3, 0.7)
        row = (1 - part) * share[parent] + part * share[child]  # between the two ends' shares
        row[[parent, child]] = share[parent, child]
        share = np.pad(share, ((0, 1), (0, 1)))
        share[-1, :-1] = share[:-1, -1] = row
        joints = np.concatenate([joints, [(1 - part) * joints[parent] + part * joints[child]]])
        parents = np.append(parents, parent)
        parents[child] = len(joints) - 1
    joints = (joints + rng.normal(0, JOINT_JITTER, joints.shape)).astype(np.float32)
    return joints, parents, share


class SkeletonObjective(Objective):
    """Bones: binary cross-entropy over all pairs of joints, the mean of its hardest 30% (online hard example mining), and a
    ranking. Root: cross-entropy of a softmax over the joints of each character.

    The ranking is ours: the tree compares bones that compete for a joint, so for every joint a softmax over all its pairs
    is held against its true bones.
    """

    def batch(self, characters, progress, rng, device):
        batch = self.shapes(characters, rng, device)
        edited = []
        for joints, character in zip(batch["joints"], characters):
            parents, inside = character.parents.astype(int), character.inside_share
            for _ in range(1 + int(rng.random() < EDIT_PROBABILITY)):
                joints, parents, share = edited_skeleton(joints, parents, inside, rng)
                inside = share[tuple(candidate_pairs(len(joints)).T)]
            edited.append((joints, parents, np.clip(share + rng.normal(0, SHARE_JITTER, share.shape), 0, 1)))
        batch["joints"], batch["valid"] = padded_joints([joints for joints, _, _ in edited], device)
        slots = batch["joints"].shape[1]
        shares, truth = np.zeros((2, len(edited), slots, slots), np.float32)
        for graph, (_, parents, share) in enumerate(edited):
            shares[graph, : len(parents), : len(parents)] = 0.5 * (share + share.T)
            child = np.flatnonzero(parents >= 0)
            truth[graph, child, parents[child]] = truth[graph, parents[child], child] = 1
        batch["inside_share"], batch["bones"] = torch.from_numpy(shares).to(device), torch.from_numpy(truth).to(device)
        roots = [int(np.flatnonzero(parents < 0)[0]) for _, parents, _ in edited]
        batch["root"] = torch.tensor(roots, device=device)
        return batch

    def loss(self, network, batch) -> torch.Tensor:
        joints, valid, truth = batch["joints"], batch["valid"], batch["bones"]
        positions = batch["positions"].reshape(batch["graph_count"], -1, 3)
        bone, root = network(positions, joints, batch["inside_share"], valid)
        bone, root = bone.float(), root.float().masked_fill(~valid, NEVER)
        distinct = ~torch.eye(joints.shape[1], dtype=torch.bool, device=joints.device)
        pairs = valid.unsqueeze(2) & valid.unsqueeze(1) & distinct
        each = F.binary_cross_entropy_with_logits(bone, truth, reduction="none")[pairs]
        hardest = each.topk(int(HARDEST_SHARE * len(each)) + 1).values.mean()
        degree = truth.sum(2)
        taught = degree > 0
        share = truth[taught] / degree[taught].unsqueeze(1)
        ranking = -(share * F.log_softmax(bone.masked_fill(~pairs, NEVER)[taught], dim=1)).sum(1).mean()
        return each.mean() + hardest + ranking + F.cross_entropy(root, batch["root"])


class SkinObjective(Objective):
    """Cross-entropy against the reference weights of the 5 nearest bones, renormalised."""

    def batch(self, characters, progress, rng, device):
        batch = self.shapes(characters, rng, device, pose=False)
        all_features, all_masks, all_targets = [], [], []
        for character, kept, joints, scale in zip(characters, batch["kept"], batch["joints"], batch["scale"]):
            start, end = character.bone_ends[:, 0].astype(int), character.bone_ends[:, 1].astype(int)
            distance = character.bone_distance[kept].astype(np.float32) * np.abs(scale).mean()
            distance = distance * np.exp(rng.normal(0, DISTANCE_JITTER, (1, distance.shape[1])))
            moved = joints + rng.normal(0, JOINT_JITTER, joints.shape)
            nearest = nearest_bones(distance, BONES_PER_VERTEX)
            features, mask = bone_features(moved[start], moved[end], start == end, distance, nearest)
            target = weights_of_nearest_bones(character.skin_weights[kept], start[nearest]) * mask
            all_features.append(features)
            all_masks.append(mask)
            all_targets.append(target)
        for name, parts in (("bone_features", all_features), ("bone_mask", all_masks), ("target", all_targets)):
            batch[name] = torch.from_numpy(np.concatenate(parts).astype(np.float32)).to(device)
        return batch

    def loss(self, network, batch) -> torch.Tensor:
        logit = network(*shape_of(batch)[:3], batch["bone_features"], batch["bone_mask"], batch["graph_count"]).float()
        mass = batch["target"].sum(1)
        target = batch["target"] / mass.clamp(min=1e-6).unsqueeze(1)
        each = -(target * F.log_softmax(logit, dim=1)).sum(1)
        taught = mass > SKIN_MASS_MIN
        return (each * taught).sum() / taught.sum().clamp(min=1)


class HeterSkinObjective(Objective):
    """Cross-entropy and L1 distance between the weights over the links and the reference's.

    HeterSkinNet, Section 3.4, has the Kullback-Leibler divergence (here without its constant part) and a smoothing term; in its
    place ours has the L1 distance, which is what weights are judged by.
    """

    def batch(self, characters, progress, rng, device):
        batch = self.shapes(characters, rng, device, pose=False, scale=False)
        slots = max(len(c.joints) for c in characters)
        parts = {name: [] for name in LINK_INPUTS}
        for graph, (character, kept, mirrored) in enumerate(zip(characters, batch["kept"], batch["mirrored"])):
            made = heter_graph(character, kept, mirrored, slots)
            made["links"] = made["links"] + graph * slots
            made["joint_neighbours"] = made["joint_neighbours"] + graph * slots
            made["joint_links"] = made["joint_links"] + graph * len(kept) * made["links"].shape[1]
            for name in LINK_INPUTS:
                parts[name].append(made[name])
        columns = max(table.shape[1] for table in parts["joint_neighbours"])
        parts["joint_neighbours"] = [np.pad(t, ((0, 0), (0, columns - t.shape[1])), mode="edge") for t in parts["joint_neighbours"]]
        for name, values in parts.items():
            batch[name] = torch.from_numpy(np.concatenate(values)).to(device)
        features = batch["link_features"]
        noise = torch.from_numpy(np.exp(rng.normal(0, DISTANCE_JITTER, (len(features), 1, 3))).astype(np.float32)).to(device)
        features[:, :, :3] *= noise
        return batch

    def loss(self, network, batch) -> torch.Tensor:
        logit = network(*(batch[name] for name in network.inputs), batch["graph_count"]).float()
        target = batch["target"]
        mass = target.sum(1)
        taught = (mass > SKIN_MASS_MIN).float()
        share = target / mass.clamp(min=1e-6).unsqueeze(1)
        entropy = -(share * F.log_softmax(logit, dim=1)).sum(1)
        found = torch.softmax(logit, dim=1)
        away = (found - target).abs().sum(1)
        return (taught * (entropy + L1_WEIGHT * away)).sum() / taught.sum().clamp(min=1)


def shape_of(batch: dict) -> tuple:
    return batch["positions"], batch["one_ring"], batch["geodesic_ball"], batch["graph_count"]


def body_of(batch: dict) -> tuple:
    """Inputs of the joint networks."""
    return *shape_of(batch)[:3], batch["medial_offsets"], batch["graph_count"]


OBJECTIVES = {
    "rignet_skeleton_stage": SkeletonObjective,
    "rignet_skin": SkinObjective,
    "rignet_joint_pair": JointPairObjective,
    "rignet_joint_stage": JointStageObjective,
    "heter_skin_net": HeterSkinObjective,
}
