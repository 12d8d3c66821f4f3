"""Reader of rig shards: real characters, one npz per shard, many characters in each.

``meta_json`` holds uint8 bytes of a JSON list, one object per character; character k has the keys ``"%04d/" % k +``
vertices (V, 3) f32, faces (F, 3) i32, joints (J, 3) f32, parents (J,) i16 with parents[i] < i and -1 for joint 0, names (J,) of the
joints, and skin weights as CSR: w_indptr (V + 1,) i32, w_joint u8, w_value u16, rows summing to 65535. Frame: y up, facing +z, longest side 1.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Rig:
    vertices: np.ndarray  # (V, 3) f32
    faces: np.ndarray  # (F, 3) i32
    joints: np.ndarray  # (J, 3) f32
    parents: np.ndarray  # (J,) i16
    weights: np.ndarray  # (V, J) f32, rows sum to 1
    meta: dict
    names: tuple[str, ...] = ()  # of the joints, as the artist gave them; empty where unknown


class RigShard:
    """``RigShard(path)[k]`` -> Rig."""

    def __init__(self, path: Path):
        self.archive = np.load(path)
        self.metas = json.loads(bytes(self.archive["meta_json"]))

    def __len__(self) -> int:
        return len(self.metas)

    def __getitem__(self, k: int) -> Rig:
        def array(name: str) -> np.ndarray:
            return self.archive[f"{k:04d}/{name}"]

        vertices, joints = array("vertices"), array("joints")
        weights = np.zeros((len(vertices), len(joints)), np.float32)
        rows = np.repeat(np.arange(len(vertices)), np.diff(array("w_indptr")))
        np.add.at(weights, (rows, array("w_joint").astype(int)), array("w_value").astype(np.float32) / 65535)
        return Rig(vertices, array("faces"), joints, array("parents"), weights, self.metas[k],
                   tuple(map(str, array("names"))))
