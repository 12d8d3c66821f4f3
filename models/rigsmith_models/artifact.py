"""What the manifest says of a network file, and how its known answers are computed. Needs no PyTorch."""

from pathlib import Path

import numpy as np
import onnxruntime

from . import known_answer

SELF_TEST_VALUES = 16
SELF_TEST_TOLERANCE = 1e-3
FORBIDDEN_OPERATORS = {"ScatterElements", "ScatterND", "Scatter"}

SHAPES = {
    "positions": ("V", 3), "one_ring": ("V", "K1"), "geodesic_ball": ("V", "K2"), "medial_offsets": ("V", 3),
    "joints": ("J", 3), "pairs": ("P", 2), "pair_features": ("P", 2), "bone_features": ("V", 40), "bone_mask": ("V", 5), "displacement": ("V", 3),
    "joint_features": ("J", 8), "joint_neighbours": ("J", "K3"), "links": ("V", 8), "link_mask": ("V", 8),
    "link_features": ("V", 8, 13), "joint_links": ("J", 32), "joint_mask": ("J",), "link_logit": ("V", 8),
    "attention_logit": ("V",), "bone_logit": ("P",), "root_logit": ("J",), "skin_logit": ("V", 5),
}
INDICES = {"one_ring": "V", "geodesic_ball": "V", "pairs": "J", "joint_neighbours": "J", "links": "J", "joint_links": "L"}  # of what


def session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def self_test(path: Path, names, output: str) -> dict:
    """Outputs of the file on the known-answer inputs (models/artifacts/README.md)."""
    values = session(path).run(None, known_answer.inputs(names))[0].astype(np.float64)
    return {
        "output": output, "first": [round(float(v), 7) for v in values.reshape(-1)[:SELF_TEST_VALUES]],
        "mean": round(float(values.mean()), 7), "std": round(float(values.std()), 7), "tolerance": SELF_TEST_TOLERANCE,
    }


def described(names) -> list[dict]:
    return [{"name": n, "dtype": "int64" if n in INDICES else "float32", "shape": list(SHAPES[n])} for n in names]
