"""Weighs characters whose parts stand apart, poses them, and looks whether every part follows its bone.

    python skin_cases.py [--sheet OUT.png] FOLDER

Cases: a skirt with bones outside the body, a ball that floats beside it, a ponytail, eyeballs in a head, and an animal made of
boxes. The meshes and skeletons are made here; the built program weighs them (`rigsmith skin`). A case passes when every vertex
has weights of sum 1, when what should follow a turned bone does, and when what should stay does. FOLDER gets inputs and
outputs; `--sheet` draws each case before and after. Ends with the summary that `make test` adds up.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "models"))

from mesh_files import write_obj  # noqa: E402
from rigsmith_models.evaluation.pictures import CELL, View, draw_mesh, draw_skeleton, joint_colours  # noqa: E402
from solids import Mesh, block, joined, ring_of, sphere, tube  # noqa: E402

BINARY = ROOT / "target/release/rigsmith"
SECONDS = 120
# Of the way that a vertex would go if its bone alone moved it. Artists' weights blend over about a tenth of a part's length.
FOLLOWS_AT_LEAST = 0.5
# Vertices that may lag: those where a part begins.
LAGGING_MAX = 0.02
# What should stay may move by this part of the height.
STAYS_WITHIN = 0.02


@dataclass
class Follower:
    """Vertices that should go where a joint takes them."""

    part: str
    joint: str
    # Keeps the vertices at which it is true: without the place where the part is attached.
    where: callable = lambda vertices: np.ones(len(vertices), bool)


@dataclass
class Case:
    name: str
    parts: dict[str, Mesh]
    # name: (parent, position); parents first
    joints: dict[str, tuple[str | None, tuple[float, float, float]]]
    # joint: (axis, degrees)
    pose: dict[str, tuple[tuple[float, float, float], float]]
    followers: list[Follower]
    stays: list[str] = field(default_factory=list)


def trunk() -> dict[str, Mesh]:
    """Body, head and legs of a plain figure, one unit high, facing +z."""
    return {
        "body": tube((0, 0.42, 0), (0, 0.8, 0), 0.13, 0.12, 28, 16),
        "head": sphere((0, 0.9, 0), 0.1, 28),
        "leg_l": tube((0.065, 0.46, 0), (0.065, 0, 0), 0.06, 0.05, 18, 18),
        "leg_r": tube((-0.065, 0.46, 0), (-0.065, 0, 0), 0.06, 0.05, 18, 18),
    }


TRUNK_JOINTS = {
    "hips": (None, (0, 0.47, 0)),
    "chest": ("hips", (0, 0.65, 0)),
    "head": ("chest", (0, 0.84, 0)),
    "thigh_l": ("hips", (0.065, 0.44, 0)), "shin_l": ("thigh_l", (0.065, 0.22, 0)), "foot_l": ("shin_l", (0.065, 0.03, 0)),
    "thigh_r": ("hips", (-0.065, 0.44, 0)), "shin_r": ("thigh_r", (-0.065, 0.22, 0)), "foot_r": ("shin_r", (-0.065, 0.03, 0)),
}  # fmt: skip
SKIRT_BONES = 8


def skirt() -> Case:
    """A cone around the legs, open below, with a ring of bones outside it."""
    parts = trunk() | {"skirt": tube((0, 0.5, 0), (0, 0.16, 0), 0.14, 0.27, 40, 14, closed=False)}
    joints = dict(TRUNK_JOINTS)
    pose = {"thigh_l": ((1, 0, 0), -35.0)}
    followers = [Follower("leg_l", "thigh_l", lambda v: (v[:, 1] < 0.36) & (v[:, 1] > 0.24))]
    for index, out in enumerate(ring_of(SKIRT_BONES)):
        top, tip = f"skirt_{index}", f"skirt_{index}_tip"
        joints[top] = ("hips", tuple(out * 0.17 + (0, 0.46, 0)))
        joints[tip] = (top, tuple(out * 0.29 + (0, 0.18, 0)))
        # Outward: about the horizontal axis along the hem.
        pose[top] = (tuple(np.cross(out, (0, 1, 0))), 25.0)
        near = lambda v, out=out: (v[:, 1] < 0.34) & (v @ out > 0.96 * np.hypot(v[:, 0], v[:, 2]))  # noqa: E731
        followers.append(Follower("skirt", top, near))
    return Case("skirt", parts, joints, pose, followers, ["head", "leg_r"])


def floating_ball() -> Case:
    parts = trunk() | {"ball": sphere((0.34, 0.8, 0.02), 0.07, 20)}
    joints = TRUNK_JOINTS | {"ball_orbit": ("chest", (0.26, 0.78, 0.01)), "ball": ("ball_orbit", (0.34, 0.8, 0.02))}
    return Case("floating ball", parts, joints, {"ball_orbit": ((0, 0, 1), 50.0)}, [Follower("ball", "ball")], ["body", "head"])


def ponytail() -> Case:
    bend = [(0, 0.95, -0.09), (0, 0.93, -0.17), (0, 0.8, -0.2), (0, 0.62, -0.2)]
    links = [tube(a, b, 0.035, 0.028, 14, 8) for a, b in zip(bend, bend[1:], strict=False)]
    parts = trunk() | {"ponytail": joined(links)}
    joints = TRUNK_JOINTS | {
        "tail_1": ("head", bend[0]), "tail_2": ("tail_1", bend[1]), "tail_3": ("tail_2", bend[2]), "tail_end": ("tail_3", bend[3]),
    }  # fmt: skip
    lower = Follower("ponytail", "tail_3", lambda v: v[:, 1] < 0.72)
    return Case("ponytail", parts, joints, {"tail_2": ((1, 0, 0), 55.0)}, [lower], ["body", "leg_l"])


def eyeballs() -> Case:
    eyes = {f"eye_{side}": sphere((x, 0.91, 0.085), 0.028, 16) for side, x in (("l", 0.04), ("r", -0.04))}
    joints = TRUNK_JOINTS | {f"eye_{side}": ("head", (x, 0.91, 0.085)) for side, x in (("l", 0.04), ("r", -0.04))}
    followers = [Follower(name, name) for name in eyes]
    return Case("eyeballs", trunk() | eyes, joints, {name: ((0, 1, 0), 60.0) for name in eyes}, followers, ["body"])


def box_animal() -> Case:
    legs = {
        f"leg_{end}{side}": ((x, 0.2, z), (0.06, 0.2, 0.06))
        for end, z in (("f", 0.28), ("b", -0.28)) for side, x in (("l", 0.12), ("r", -0.12))
    }  # fmt: skip
    boxes = {"body": ((0, 0.52, 0), (0.18, 0.13, 0.38)), "head": ((0, 0.72, 0.5), (0.12, 0.12, 0.14)), "tail": ((0, 0.6, -0.5), (0.03, 0.03, 0.13))}
    parts = {name: block(*box) for name, box in (boxes | legs).items()}
    joints = {
        "hips": (None, (0, 0.52, -0.3)), "chest": ("hips", (0, 0.52, 0.25)), "neck": ("chest", (0, 0.62, 0.4)), "head": ("neck", (0, 0.72, 0.5)),
        "tail": ("hips", (0, 0.58, -0.38)), "tail_end": ("tail", (0, 0.6, -0.62)),
    }  # fmt: skip
    for name, ((x, _, z), _) in legs.items():
        joints[name] = ("chest" if name.startswith("leg_f") else "hips", (x, 0.42, z))
        joints[f"{name}_foot"] = (name, (x, 0.03, z))
    pose = {"leg_fl": ((1, 0, 0), -40.0), "leg_br": ((1, 0, 0), 40.0), "neck": ((1, 0, 0), 35.0), "tail": ((0, 1, 0), 50.0)}
    # A leg is one box: its foot alone takes it nowhere.
    pose["leg_fr_foot"] = ((1, 0, 0), 60.0)
    followers = [
        Follower("leg_fl", "leg_fl", lambda v: v[:, 1] < 0.1), Follower("leg_br", "leg_br", lambda v: v[:, 1] < 0.1),
        Follower("head", "neck"), Follower("tail", "tail", lambda v: v[:, 2] < -0.5),
    ]  # fmt: skip
    return Case("box animal", parts, joints, pose, followers, ["leg_fr", "leg_bl"])


CASES = (skirt, floating_ball, ponytail, eyeballs, box_animal)


def skin(case: Case, mesh: Mesh, folder: Path) -> np.ndarray:
    """Weights `[V, J]` by the program."""
    stem = folder / case.name.replace(" ", "-")
    names = list(case.joints)
    joints = [
        {"name": name, "parent": None if parent is None else names.index(parent), "position": [float(x) for x in position]}
        for name, (parent, position) in case.joints.items()
    ]
    skeleton, output = stem.with_suffix(".skeleton.json"), stem.with_suffix(".rig.json")
    skeleton.write_text(json.dumps({"format": "rigsmith.rig/1", "joints": joints}))
    write_obj(stem.with_suffix(".obj"), mesh.vertices, mesh.faces)
    command = [BINARY, "skin", stem.with_suffix(".obj"), "--skeleton", skeleton, "--up", "y", "--front", "z", "-o", output]
    subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True, timeout=SECONDS)
    rig = json.loads(output.read_text())
    weights = np.zeros((len(mesh.vertices), len(names)))
    rows = [row for skin in rig["skins"] for row in zip(skin["joints"], skin["weights"], strict=True)]
    for vertex, (joints, shares) in enumerate(rows):
        weights[vertex, joints] = shares
    return weights


def turned(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """The rotation about an axis [Rodrigues]."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def joint_motions(case: Case) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Rotation and translation that each joint gives to what follows it."""
    motions = {}
    for name, (parent, position) in case.joints.items():
        rotation, translation = motions.get(parent, (np.eye(3), np.zeros(3)))
        if name in case.pose:
            place = rotation @ np.asarray(position, float) + translation
            rotation = turned(*case.pose[name]) @ rotation
            translation = place - rotation @ np.asarray(position, float)
        motions[name] = (rotation, translation)
    return motions


def posed(case: Case, vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    moved = np.zeros_like(vertices)
    for joint, (rotation, translation) in enumerate(joint_motions(case).values()):
        moved += weights[:, joint, None] * (vertices @ rotation.T + translation)
    return moved


def faults(case: Case, ranges: dict[str, slice], vertices: np.ndarray, weights: np.ndarray) -> list[str]:
    found = []
    unsound = np.abs(weights.sum(1) - 1) > 1e-5
    if unsound.any():
        found.append(f"{unsound.sum()} vertices have no weights of sum 1")
    after, motions = posed(case, vertices, weights), joint_motions(case)
    height = np.ptp(vertices[:, 1])
    for follower in case.followers:
        part = vertices[ranges[follower.part]]
        chosen = follower.where(part)
        rotation, translation = motions[follower.joint]
        way = part @ rotation.T + translation - part
        # What lies on the axis goes nowhere.
        chosen &= np.linalg.norm(way, axis=1) > 0.005 * height
        went = after[ranges[follower.part]] - part
        share = (went * way).sum(1)[chosen] / (way * way).sum(1)[chosen]
        lagging = (share < FOLLOWS_AT_LEAST).mean()
        if not chosen.any() or lagging > LAGGING_MAX:
            found.append(f"{lagging:.0%} of {follower.part} lag behind {follower.joint} ({chosen.sum()} vertices, mean share {share.mean():.2f})")
    for name in case.stays:
        went = np.linalg.norm(after[ranges[name]] - vertices[ranges[name]], axis=1).max() / height
        if went > STAYS_WITHIN:
            found.append(f"{name} moved by {went:.3f} of the height")
    return found


def draw_sheet(path: Path, drawn: list[tuple[Case, Mesh, dict[str, slice], np.ndarray]]) -> None:
    """A column per case: at rest with its skeleton, and posed; each part in a colour of its own."""
    sheet = Image.new("RGB", (CELL * len(drawn), 2 * CELL + 16), "white")
    draw = ImageDraw.Draw(sheet)
    for column, (case, mesh, ranges, after) in enumerate(drawn):
        colours = np.zeros((len(mesh.vertices), 3))
        for part, colour in zip(ranges.values(), joint_colours(len(ranges))):
            colours[part] = colour
        view, left = View(np.concatenate([mesh.vertices, after])), column * CELL
        for row, vertices in enumerate((mesh.vertices, after)):
            draw_mesh(draw, view, left, 16 + row * CELL, vertices, mesh.faces, colours)
        names = list(case.joints)
        parents = [names.index(parent) if parent else -1 for parent, _ in case.joints.values()]
        places = np.array([place for _, place in case.joints.values()])
        draw_skeleton(draw, view, left, 16, places, parents, "#26323e")
        draw.text((left + 6, 2), case.name, fill="black")
    sheet.save(path, optimize=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sheet", type=Path, help="draw every case before and after")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    failed, drawn = 0, []
    for make in CASES:
        case = make()
        mesh = joined(case.parts.values())
        starts = np.cumsum([0, *(len(part.vertices) for part in case.parts.values())])
        ranges = {name: slice(a, b) for name, a, b in zip(case.parts, starts, starts[1:], strict=False)}
        try:
            weights = skin(case, mesh, arguments.folder)
        except subprocess.CalledProcessError as error:
            found = [f"exit code {error.returncode}: {error.stderr.strip()[-300:]}"]
        else:
            found = faults(case, ranges, mesh.vertices, weights)
            drawn.append((case, mesh, ranges, posed(case, mesh.vertices, weights)))
        failed += bool(found)
        for fault in found:
            print(f"FAILED skinning: {case.name}: {fault}", flush=True)
    if arguments.sheet:
        draw_sheet(arguments.sheet, drawn)
    print(f"skinning: {len(CASES) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
