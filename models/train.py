"""Trains one network for some minutes.

    python models/train.py rignet_displacement --data CACHE/*.npz --minutes 10 --resume
    python models/train.py due --data CACHE/*.npz --minutes 10 --resume      (the network that is farthest behind)

The run lives in models/runs/<name>/ (not committed). Stop it at any moment; the same command goes on.
"""

import argparse
import json
import sys
from pathlib import Path

import torch

from rigsmith_models.data.sampling import Pool
from rigsmith_models.train.schedule import PLANS, next_due
from rigsmith_models.train.trainer import Run, Settings

RUNS = Path(__file__).parent / "runs"


def record_data(run: Run, pool: Pool) -> None:
    """Appends to the run's data.json what it is trained on from this step, when that has changed."""
    path = run.folder / "data.json"
    history = json.loads(path.read_text()) if path.exists() else []
    now = {"characters": pool.counts(), "features": pool.features()}
    if not history or {k: history[-1][k] for k in now} != now:
        path.write_text(json.dumps([*history, {"from_step": run.step, **now}], indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=[*PLANS, "due"])
    parser.add_argument("--data", nargs="+", type=Path, required=True, help="cache files made by rigsmith_models.data.prepare")
    parser.add_argument("--minutes", type=float, required=True, help="wall clock")
    parser.add_argument("--name", help="folder under models/runs; default: the network")
    parser.add_argument("--steps", type=int, help="length of the whole schedule; default: train/schedule.py")
    parser.add_argument("--width", type=float, default=Settings.width)
    parser.add_argument("--normalisation", default=Settings.normalisation, choices=("layer", "batch"))
    parser.add_argument("--learning-rate", type=float, help="default: train/schedule.py")
    parser.add_argument("--characters-per-step", type=int, default=Settings.characters_per_step)
    parser.add_argument("--real-share", type=float, default=Settings.real_share, help="of the draws; the others are generated characters")
    parser.add_argument("--seed", type=int, default=Settings.seed)
    parser.add_argument("--device", default="auto", help="auto, cpu or cuda")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint if there is one")
    arguments = parser.parse_args()

    torch.set_num_threads(arguments.threads)
    device = arguments.device
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    plan = next_due(RUNS) if arguments.network == "due" else PLANS[arguments.network]
    if plan is None:
        sys.exit("nothing is due: every network has done its steps (train/schedule.py)")
    settings = Settings(
        network=plan.network, width=arguments.width, normalisation=arguments.normalisation,
        steps=arguments.steps or plan.steps, learning_rate=arguments.learning_rate or plan.learning_rate,
        characters_per_step=arguments.characters_per_step, seed=arguments.seed,
        real_share=arguments.real_share,
    )
    run = Run(RUNS / (arguments.name or plan.network), settings, device, arguments.resume)
    if run.path.exists() and not arguments.resume:
        sys.exit(f"{run.path} exists; pass --resume to go on, or --name for another run")
    pool = Pool(arguments.data)
    record_data(run, pool)
    run.train(pool, arguments.minutes)
    print(f"{settings.network}: step {run.step} of {settings.steps}, {run.seconds / 60:.1f} CPU minutes in all")


if __name__ == "__main__":
    main()
