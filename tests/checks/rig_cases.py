"""Rigs every case of the checks with the built program and writes what the other checks read.

    python rig_cases.py [--previews] [--limit N] FOLDER

Cases: our sample character; characters of the generator, as OBJ and as GLB; and, where the project's shared data folder
lies beside the repository, its sample files (existing skeletons replaced, and two whose joints are turned kept: in their
place, and as a file of their own) and a spread of its rigs without their rig, as
OBJ and as GLB. FOLDER gets the inputs, one output per case, one pose per output (examples/pose.rs) and `cases.json`.
Ends with the summary that `make test` adds up. A case that takes longer than SECONDS counts as failed.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path.insert(0, str(ROOT / "models"))

from mesh_files import write_glb, write_obj  # noqa: E402
from rigsmith_models.data.synthetic import generate  # noqa: E402

BINARY = ROOT / "target/release/rigsmith"
POSE = ROOT / "target/release/examples/pose"
SHARED = ROOT.parent / "shared" / "data"
SECONDS = 120
# One of each kind: (seed, family). Half go in as OBJ, half as GLB.
GENERATED = [
    (101, "human"), (102, "chibi"), (103, "robot"), (104, "quadruped"), (105, "dragon"), (106, "bird"), (107, "fish"), (108, "bug"),
]  # fmt: skip
# Artists' files whose joints have orientations. The shark's mesh and armature differ in scale, which Blender's importer keeps apart, so it
# is only sent apart.
TURNED_KEPT, TURNED_APART = ("m2m_human_male_rigged",), ("m2m_human_male_rigged", "quaternius_shark_rigged")
SHARD_RIGS = 44  # spread over the shards below
SHARDS = ("train.npz", "train2.npz", "train_box.npz", "val.npz", "val2.npz")


@dataclass
class Case:
    name: str
    input: Path
    arguments: tuple[str, ...] = ()
    command: str = "rig"


def our_own(folder: Path) -> list[Case]:
    sample = folder / "input" / "sample-character.glb"
    shutil.copy(ROOT / "tests/fixtures/sample-character.glb", sample)
    cases = [Case("sample-character", sample)]
    for index, (seed, family) in enumerate(GENERATED):
        character = generate(seed, family=family)
        name = f"generated-{seed}-{family}"
        cases.append(Case(name, bare_mesh(folder, name, index, character.vertices, character.faces)))
    return cases


def bare_mesh(folder: Path, name: str, index: int, vertices: np.ndarray, faces: np.ndarray) -> Path:
    suffix, write = [(".obj", write_obj), (".glb", write_glb)][index % 2]
    path = folder / "input" / f"{name}{suffix}"
    write(path, vertices, faces)
    return path


def shared_samples(folder: Path) -> list[Case]:
    cases = []
    for path in sorted((SHARED / "samples").glob("*.glb")):
        copy = folder / "input" / path.name
        shutil.copy(path, copy)
        cases.append(Case(path.stem, copy, ("--existing-rig", "replace") if "_rigged" in path.stem else ()))
        if path.stem in TURNED_KEPT:
            cases.append(Case(f"{path.stem}-kept", copy, command="skin"))
        if path.stem in TURNED_APART:
            cases.append(Case(f"{path.stem}-apart", copy, ("--existing-rig", "replace", "--skeleton", str(copy)), "skin"))
    return cases


def shared_rigs(folder: Path) -> list[Case]:
    """Meshes of the shared rigs, evenly spread over the shards, without skeleton and weights."""
    specification = importlib.util.spec_from_file_location("rigset", SHARED / "rigset.py")
    rigset = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(rigset)
    shards = [rigset.RigShard(SHARED / "rigs" / name) for name in SHARDS]
    everything = [(shard, index) for shard in shards for index in range(len(shard))]
    chosen = np.linspace(0, len(everything) - 1, SHARD_RIGS).astype(int)
    cases = []
    for number, place in enumerate(chosen):
        shard, index = everything[place]
        rig = shard[index]
        # The artist's own low-poly mesh where there is one: closer to what users send.
        vertices, faces = (rig.get("lo_vertices", rig["vertices"]), rig.get("lo_faces", rig["faces"]))
        name = f"shard-{number:02}-{''.join(c if c.isalnum() else '-' for c in rig['meta']['id'])}"
        cases.append(Case(name, bare_mesh(folder, name, number, vertices, faces)))
    return cases


def rig(case: Case, folder: Path, previews: bool) -> str | None:
    """Runs the program; returns what went wrong, if anything."""
    outputs = ["-o", str(folder / f"{case.name}.glb")]
    if previews:
        outputs += ["-o", str(folder / f"{case.name}.png")]
    command = [str(BINARY), case.command, str(case.input), *outputs, *case.arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return f"took longer than {SECONDS} s"
    if done.returncode != 0:
        return f"exit code {done.returncode}: {' '.join(done.stderr.split())[-300:]}"
    return None


def pose(case: Case, folder: Path) -> str | None:
    output, target = folder / f"{case.name}.glb", folder / f"{case.name}.pose.json"
    done = subprocess.run([str(POSE), str(output), str(target)], capture_output=True, text=True, timeout=SECONDS)
    return None if done.returncode == 0 else f"the output could not be posed: {done.stderr.strip()}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--previews", action="store_true", help="draw each rig as PNG as well")
    parser.add_argument("--limit", type=int, help="only the first N cases")
    arguments = parser.parse_args()
    folder = arguments.folder.resolve()
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "input").mkdir(parents=True)

    cases = our_own(folder)
    if SHARED.is_dir():
        cases += shared_samples(folder) + shared_rigs(folder)
    else:
        print("the shared data folder is not beside the repository: only our own characters are rigged")
    cases = cases[: arguments.limit]

    entries, failed = [], 0
    for case in cases:
        started = time.monotonic()
        problem = rig(case, folder, arguments.previews) or pose(case, folder)
        if problem:
            failed += 1
            print(f"FAILED rigging: {case.name}: {problem}", flush=True)
            continue
        print(f"{case.name}: {time.monotonic() - started:.1f} s", flush=True)
        is_gltf = case.input.suffix in (".glb", ".gltf")
        entries.append({
            "name": case.name, "input": str(case.input.relative_to(folder)) if is_gltf else None,
            "output": f"{case.name}.glb", "pose": f"{case.name}.pose.json",
        })  # fmt: skip
    (folder / "cases.json").write_text(json.dumps(entries, indent=1))
    print(f"rigging: {len(cases) - failed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
