"""One training sample, and the cache file that holds many of them.

A cache file is an npz: ``meta_json`` (uint8 bytes of a JSON list, one object per character) and the arrays of
character k under the keys ``"%04d/<field>" % k``. It is derived data: never committed, rebuilt by ``prepare.py``.
"""

import json
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np


@dataclass
class Character:
    """All positions in the normalised frame: y up, facing +z, longest side 1, centred in x and z, lowest y 0.

    The tables ``one_ring`` and ``geodesic_ball`` list neighbours only; a short row is padded with the own index.
    ``bone_ends`` are (parent, child) joint indices in the order of the features; a leaf joint has a bone (j, j).
    Links, their features and the joints' are those of ``rig::heter_graph`` in the service.
    """

    positions: np.ndarray  # (V, 3) f32
    medial_offsets: np.ndarray  # (V, 3) f32, from the vertex to the middle of its body part, zero where unknown
    one_ring: np.ndarray  # (V, K1) i32
    geodesic_ball: np.ndarray  # (V, K2) i32
    joints: np.ndarray  # (J, 3) f32
    parents: np.ndarray  # (J,) i16, -1 for the root
    skin_weights: np.ndarray  # (V, J) f16, rows sum to 1
    attention_mask: np.ndarray  # (V,) bool, near the surface hits of rays from the joints
    tolerance: np.ndarray  # (J,) f32, mean distance from joint to surface
    inside_share: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))  # (P,) of the pairs i < j
    bone_ends: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int16))  # (B, 2)
    bone_distance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))  # (V, B)
    links: np.ndarray = field(default_factory=lambda: np.zeros((0, 8), np.uint8))  # (V, 8) joint of each link
    link_mask: np.ndarray = field(default_factory=lambda: np.zeros((0, 8), bool))  # (V, 8)
    link_features: np.ndarray = field(default_factory=lambda: np.zeros((0, 8, 13), np.float16))  # (V, 8, 13)
    joint_features: np.ndarray = field(default_factory=lambda: np.zeros((0, 8), np.float32))  # (J, 8)
    meta: dict = field(default_factory=dict)  # name, source, family, category, style, license, draw_weight


ARRAYS = [f.name for f in fields(Character) if f.name != "meta"]


def write_cache(path: Path, characters: list[Character]) -> None:
    arrays = {f"{k:04d}/{name}": getattr(c, name) for k, c in enumerate(characters) for name in ARRAYS}
    arrays["meta_json"] = np.frombuffer(json.dumps([c.meta for c in characters]).encode(), np.uint8)
    temporary = path.with_suffix(".tmp.npz")
    np.savez(temporary, **arrays)
    temporary.replace(path)


def read_cache(path: Path) -> list[Character]:
    with np.load(path) as archive:
        metas = json.loads(bytes(archive["meta_json"]))
        names = [name for name in ARRAYS if f"0000/{name}" in archive.files]  # fields with a default may be absent
        return [Character(**{name: archive[f"{k:04d}/{name}"] for name in names}, meta=meta) for k, meta in enumerate(metas)]
