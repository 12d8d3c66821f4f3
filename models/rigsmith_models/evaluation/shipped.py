"""The shipped files: networks through ONNX Runtime, and the manifest that describes them."""

import json
import time
from pathlib import Path

import numpy as np
import onnxruntime

from .clustering import Clustering

ARTIFACTS = Path(__file__).parents[2] / "artifacts"
MANIFEST = ARTIFACTS / "manifest.json"


class Network:
    """A shipped graph as a function of its inputs by name."""

    def __init__(self, path: Path):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.seconds = []

    def __call__(self, **inputs) -> np.ndarray:
        started = time.process_time()
        result = self.session.run(None, inputs)[0]
        self.seconds.append(time.process_time() - started)
        return result


def manifest() -> dict:
    return json.loads(MANIFEST.read_text())


def networks() -> dict[str, Network]:
    return {name: Network(ARTIFACTS / entry["file"]) for name, entry in manifest()["networks"].items()}


def clustering_of(entry: dict) -> Clustering:
    """``calibration`` of the manifest."""
    return Clustering(entry["bandwidth"], entry["mean_shift_steps"], entry["mean_shift_step_length"], entry["attention_power"],
                      entry["attention_min"], entry["mode_density_min"], entry["suppression_displacement"], entry["middle_max"])
