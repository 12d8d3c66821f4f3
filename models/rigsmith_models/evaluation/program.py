"""The built program as a function: a mesh in, a skeleton and skin weights out.

Meshes go in as OBJ in the normalised frame, with both axes named, so that nothing is guessed; results come back in the same
coordinates. One process per call, one thread, as ``RAYON_NUM_THREADS`` and ``--threads`` say.
"""

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RIG_FORMAT = "rigsmith.rig/1"
TIMEOUT_S = 600


@dataclass
class Rigged:
    joints: np.ndarray  # (J, 3)
    parents: np.ndarray  # (J,), -1 for the root
    weights: np.ndarray  # (V, J)
    report: dict


class Refused(Exception):
    """The program ended without a rig; the message is what it said."""


class Program:
    def __init__(self, path: Path, options: list[str] | None = None):
        self.path, self.options = path.resolve(), options or []

    def rig(self, vertices: np.ndarray, faces: np.ndarray, *options: str) -> Rigged:
        with tempfile.TemporaryDirectory() as folder:
            return self._run(Path(folder), "rig", vertices, faces, [*self.options, *options])

    def skin(self, vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, parents: np.ndarray, *options: str) -> Rigged:
        """Weights for a skeleton that is given. The skeleton that comes back must be the one that went in."""
        with tempfile.TemporaryDirectory() as folder:
            skeleton = Path(folder) / "given.rig.json"
            skeleton.write_text(json.dumps({"format": RIG_FORMAT, "joints": [
                {"name": f"joint_{k}", "parent": int(parent) if parent >= 0 else None, "position": [float(x) for x in joint]}
                for k, (joint, parent) in enumerate(zip(joints, parents))]}))
            made = self._run(Path(folder), "skin", vertices, faces, ["--skeleton", str(skeleton), *options])
        if not (np.array_equal(made.parents, parents) and np.array_equal(made.joints, np.asarray(joints, float))):
            raise Refused("the skeleton that came back is not the one that was given")
        return made

    def _run(self, folder: Path, command: str, vertices, faces, options: list[str]) -> Rigged:
        mesh, result = folder / "mesh.obj", folder / "out.rig.json"
        mesh.write_text(obj_text(vertices, faces))
        arguments = [str(self.path), command, str(mesh), "-o", str(result), "--report", str(folder / "report.json"),
                     "--up", "y", "--front", "z", "--threads", "1", *options]
        environment = {**os.environ, "RAYON_NUM_THREADS": "1"}
        done = subprocess.run(arguments, capture_output=True, text=True, env=environment, timeout=TIMEOUT_S)
        if done.returncode != 0:
            raise Refused(done.stderr.strip())
        report = json.loads((folder / "report.json").read_text())
        return rigged_of(json.loads(result.read_text()), report, len(vertices))


def obj_text(vertices: np.ndarray, faces: np.ndarray) -> str:
    lines = ["v %.9g %.9g %.9g" % tuple(v) for v in vertices] + ["f %d %d %d" % tuple(f + 1) for f in faces]
    return "\n".join(lines) + "\n"


def rigged_of(rig: dict, report: dict, vertex_count: int) -> Rigged:
    joints = rig["joints"]
    weights = np.zeros((vertex_count, len(joints)))
    rows = [row for skin in rig["skins"] for row in zip(skin["joints"], skin["weights"])]
    if len(rows) != vertex_count:
        raise Refused(f"{len(rows)} rows of weights for {vertex_count} vertices")
    for vertex, (members, shares) in enumerate(rows):
        weights[vertex, members] = shares
    return Rigged(
        np.array([joint["position"] for joint in joints]),
        np.array([-1 if joint["parent"] is None else joint["parent"] for joint in joints]), weights, report)
