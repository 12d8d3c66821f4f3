"""Judges the checkpoints of a joint run as they come, until the process that writes them is gone; appends to the run's judged.jsonl.

    python models/judge_run.py runs/rignet_joint_pair --on val=CACHE/val.npz,CACHE/val2.npz --on train=CACHE/train2.npz --process PID
"""

import argparse
import json
import os
import time
from pathlib import Path

import torch

from rigsmith_models.data.sampling import Pool
from rigsmith_models.evaluation.clustering import Clustering
from rigsmith_models.train.judge import judged
from rigsmith_models.train.trainer import averaged_network

DENSITY_MIN = 0.005  # as shipped when the first GPU run was judged, so that runs compare
CHARACTERS_MAX = 32
PAUSE_SECONDS = 2.0


def alive(process: int) -> bool:
    return Path(f"/proc/{process}").exists()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--on", action="append", required=True, help="NAME=FILE,FILE...; box characters are left out")
    parser.add_argument("--bandwidth", type=float, nargs="+", default=[0.045])
    parser.add_argument("--process", type=int, default=os.getppid(), help="stop when it has ended")
    parser.add_argument("--reference-mask", action="store_true", help="figures with the true attention mask too")
    arguments = parser.parse_args()
    torch.set_num_threads(2)
    sets = {}
    for entry in arguments.on:
        name, files = entry.split("=", 1)
        characters = [c for c in Pool([Path(f) for f in files.split(",")]).characters if c.meta["style"] != "box"]
        sets[name] = characters[:: max(1, len(characters) // CHARACTERS_MAX)][:CHARACTERS_MAX]
    checkpoint, seen = arguments.run / "checkpoint.pt", 0.0
    while True:
        last = not alive(arguments.process)
        if checkpoint.exists() and checkpoint.stat().st_mtime != seen:
            seen = checkpoint.stat().st_mtime
            network, record = averaged_network(checkpoint)
            for name, characters in sets.items():
                for masked in (False, True)[: 1 + arguments.reference_mask]:
                    for bandwidth in arguments.bandwidth:
                        figures = judged(network, characters, Clustering(bandwidth=bandwidth, density_min=DENSITY_MIN), masked)
                        line = {"step": record["step"], "set": name, "bandwidth": bandwidth, "mask": masked,
                                **{k: round(v, 4) for k, v in figures.items()}, "time": time.strftime("%H:%M:%S")}
                        with open(arguments.run / "judged.jsonl", "a") as file:
                            file.write(json.dumps(line) + "\n")
        if last:
            return
        time.sleep(PAUSE_SECONDS)


if __name__ == "__main__":
    main()
