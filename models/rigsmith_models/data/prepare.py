"""Rig shards or synthetic seeds -> cache files that training reads.

    python -m rigsmith_models.data.prepare shard DATA/rigs/train.npz -o CACHE/train.npz --rigsmith target/release/rigsmith
    python -m rigsmith_models.data.prepare synthetic --first-seed 1000 --count 200 -o CACHE/synthetic0.npz --rigsmith ...

    ... shard ... --predicted [--bandwidth 0.036]       characters with the joints that the service finds, for bone and root

Neighbour tables, inside shares and bone distances come from ``rigsmith features``: the code that the service runs, so
that training and service cannot drift apart. Rays (tolerance, attention mask) are ours alone, see ``targets.py``.
"""

import argparse
import os
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..evaluation.program import Program
from . import augment, targets
from .character import Character, write_cache
from .predicted import with_joints
from .shards import Rig, RigShard
from .synthetic.families import FAMILIES

WORKING_VERTICES = 1100
WORKING_SPREAD = 0.15  # the vertex count is drawn within so much of it
DECIMATE_FROM = 1.25  # times the wanted count: smaller meshes stay as they are
ONE_RING_COLUMNS, BALL_COLUMNS = 8, 32  # longer rows keep a random choice
CHARACTERS_PER_CALL = 40
STYLE_WEIGHT = {"box": 0.2, "parametric": 0.5}  # of the draw, 1 for every other style
FAMILY_WEIGHT_MAX = 10.0  # all members of one family (one body, many clothes) together draw at most so much
WEIGHTLESS_AREA = 1e-14
VARIANT_POSED, VARIANT_JITTER = 0.7, 0.006  # share of posed variants; of a joint's place, about half of what prediction errs


def decimated(rig: Rig, rng: np.random.Generator) -> Rig:
    """Quadric decimation to about WORKING_VERTICES; a new vertex takes the weights of the nearest old one."""
    import fast_simplification  # only here: the generator and the tests do without it

    wanted = int(WORKING_VERTICES * rng.uniform(1 - WORKING_SPREAD, 1 + WORKING_SPREAD))
    if len(rig.vertices) < DECIMATE_FROM * wanted:
        return rig
    vertices, faces = fast_simplification.simplify(
        rig.vertices.astype(np.float32), rig.faces.astype(np.int32), target_reduction=1 - wanted / len(rig.vertices))
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    weights = rig.weights[cKDTree(rig.vertices).query(vertices)[1]]
    return Rig(vertices, faces.reshape(-1, 3), rig.joints, rig.parents, weights, rig.meta)


def without_flat_faces(faces: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """``rigsmith features`` takes a mesh as it is and expects faces that have an area."""
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > WEIGHTLESS_AREA]


def service_features(rigs: list[Rig], rigsmith: Path) -> list[dict[str, np.ndarray]]:
    """Runs ``rigsmith features`` on many characters at once -> its arrays, one dict per character."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "in.npz", Path(folder) / "out.npz"
        arrays = {}
        for k, rig in enumerate(rigs):
            arrays |= {
                f"{k:04d}/vertices": rig.vertices.astype(np.float64), f"{k:04d}/faces": rig.faces.astype(np.int32),
                f"{k:04d}/joints": rig.joints.astype(np.float64), f"{k:04d}/parents": rig.parents.astype(np.int32),
            }
        np.savez(given, **arrays)
        environment = {"RAYON_NUM_THREADS": "1", **os.environ}
        subprocess.run([rigsmith, "features", given, "-o", made], check=True, env=environment)
        with np.load(made) as archive:
            names = {name.split("/", 1)[1] for name in archive.files}
            return [{n: archive[f"{k:04d}/{n}"] for n in names if f"{k:04d}/{n}" in archive} for k in range(len(rigs))]


def padded_table(offsets: np.ndarray, members: np.ndarray, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Compressed rows -> (V, columns): the row, a random choice of a long row, padded with the own index."""
    table = np.repeat(np.arange(len(offsets) - 1, dtype=np.int32)[:, None], columns, axis=1)
    for vertex in range(len(table)):
        row = members[offsets[vertex] : offsets[vertex + 1]]
        if len(row) > columns:
            row = rng.choice(row, columns, replace=False)
        table[vertex, : len(row)] = row
    return table


def character_of(rig: Rig, features: dict[str, np.ndarray], rng: np.random.Generator) -> Character:
    vertices, joints = rig.vertices.astype(np.float64), rig.joints.astype(np.float64)
    rays = targets.joint_rays(vertices, rig.faces, joints, rig.parents)
    return Character(
        positions=rig.vertices.astype(np.float32), medial_offsets=features["medial_offsets"],
        one_ring=padded_table(features["one_ring_offsets"], features["one_ring"], ONE_RING_COLUMNS, rng),
        geodesic_ball=padded_table(features["geodesic_ball_offsets"], features["geodesic_ball"], BALL_COLUMNS, rng),
        joints=rig.joints.astype(np.float32), parents=rig.parents.astype(np.int16),
        skin_weights=rig.weights.astype(np.float16),
        attention_mask=targets.attention_mask(vertices, rays, joints), tolerance=targets.tolerance(vertices, rays, joints),
        inside_share=features["pair_features"][:, 1].astype(np.float32), bone_ends=features["bones"].astype(np.int16),
        bone_distance=features["bone_distance"].astype(np.float16), links=features["links"].astype(np.uint8),
        link_mask=features["link_mask"] > 0.5, link_features=features["link_features"].astype(np.float16),
        joint_features=features["joint_features"], meta={**rig.meta, "features": "rigsmith features"},
    )


def variant(rig: Rig, rng: np.random.Generator) -> Rig:
    """The rig in another pose and other proportions, with a skeleton that looks predicted: joints off their places, some missing.

    Features of such a rig are computed anew by the service's code, so distances and heat are true; ``augment`` alone could
    only guess them.
    """
    character = Character(
        positions=rig.vertices.astype(np.float32), medial_offsets=np.zeros_like(rig.vertices, np.float32), one_ring=np.zeros((0, 0)),
        geodesic_ball=np.zeros((0, 0)), joints=rig.joints, parents=rig.parents, skin_weights=rig.weights,
        attention_mask=np.zeros(0), tolerance=np.zeros(0))
    if rng.random() < VARIANT_POSED:
        character = augment.random_pose(character, rng)
    character, _ = augment.random_scale(character, rng)
    joints, parents, weights = augment.fewer_joints(character.joints, rig.parents, rig.weights, rng)
    joints = joints + rng.normal(0, VARIANT_JITTER, joints.shape)
    faces = without_flat_faces(rig.faces, character.positions)
    return Rig(character.positions, faces, joints.astype(np.float32), parents, weights, rig.meta)


def shard_rigs(path: Path, count: int | None, program: Program | None = None) -> list[Rig]:
    """The first ``count`` rigs, decimated, with their draw weight in ``meta``; with a ``program``, those that
    are not made of boxes, with the joints that it finds in place of the artist's."""
    shard = RigShard(path)
    chosen = range(min(count or len(shard), len(shard)))
    families = Counter(shard.metas[k]["family"] for k in chosen)
    rigs = []
    for k in chosen:
        if program and shard.metas[k]["style"] == "box":
            continue
        rig = decimated(shard[k], np.random.default_rng([11, k]))
        meta = {key: rig.meta[key] for key in ("id", "name", "source", "license", "family", "category", "style")}
        family_weight = min(1.0, FAMILY_WEIGHT_MAX / families[meta["family"]])
        if program:
            rig = with_joints(rig, program.rig(shard[k].vertices.astype(float), shard[k].faces).joints)
        weight = STYLE_WEIGHT.get(meta["style"], family_weight)
        rigs.append(Rig(rig.vertices, without_flat_faces(rig.faces, rig.vertices), rig.joints, rig.parents, rig.weights,
                        {**meta, "draw_weight": weight}))
    return rigs


def synthetic_rigs(first_seed: int, count: int, family: str | None = None) -> list[Rig]:
    from .synthetic import GENERATOR_VERSION, generate

    rigs = []
    for seed in range(first_seed, first_seed + count):
        made = generate(seed, target_vertices=1000, family=family)
        meta = {"id": f"synthetic-v{GENERATOR_VERSION}-{seed}", "name": f"synthetic-{seed}", "source": "synthetic", "license": "own",
                "family": made.family, "category": made.family, "style": "synthetic", "draw_weight": 1.0}
        rigs.append(Rig(made.vertices, without_flat_faces(made.faces, made.vertices), made.joints, made.parents, made.weights, meta))
    return rigs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="kind", required=True)
    shard = kinds.add_parser("shard")
    shard.add_argument("shard", type=Path)
    shard.add_argument("--count", type=int, help="only the first so many")
    shard.add_argument("--predicted", nargs="*", metavar="OPTION", help="joints as the program predicts them, with these options of it")
    synthetic = kinds.add_parser("synthetic")
    synthetic.add_argument("--first-seed", type=int, required=True)
    synthetic.add_argument("--count", type=int, required=True)
    synthetic.add_argument("--family", choices=FAMILIES, help="one kind of character in place of the draw")
    for part in (shard, synthetic):
        part.add_argument("-o", "--output", type=Path, required=True)
        part.add_argument("--variants", type=int, default=0, help="so many altered rigs in place of each rig as it is")
        part.add_argument("--rigsmith", type=Path, required=True, help="release binary of the service")
    arguments = parser.parse_args()

    if arguments.kind == "shard":
        program = None if arguments.predicted is None else Program(arguments.rigsmith, arguments.predicted)
        rigs = shard_rigs(arguments.shard, arguments.count, program)
    else:
        rigs = synthetic_rigs(arguments.first_seed, arguments.count, arguments.family)
    if arguments.variants:
        rigs = [variant(rig, np.random.default_rng([17, k, v])) for k, rig in enumerate(rigs) for v in range(arguments.variants)]
    characters = []
    for first in range(0, len(rigs), CHARACTERS_PER_CALL):
        some = rigs[first : first + CHARACTERS_PER_CALL]
        for k, (rig, features) in enumerate(zip(some, service_features(some, arguments.rigsmith.resolve()))):
            characters.append(character_of(rig, features, np.random.default_rng([13, first + k])))
    write_cache(arguments.output, characters)
    print(f"{arguments.output.name}: {len(characters)} characters, {np.mean([len(c.positions) for c in characters]):.0f} vertices, "
          f"{np.mean([len(c.joints) for c in characters]):.1f} joints on average")


if __name__ == "__main__":
    main()
