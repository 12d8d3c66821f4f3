"""Trains one network for some minutes.

    python models/train.py rignet_joint_pair --data CACHE/*.npz --minutes 10 --resume
    python models/train.py due --data CACHE/*.npz --minutes 10 --resume      (the network that is farthest behind)

The run lives in models/runs/<name>/ (not committed). Stop it at any moment; the same command goes on.
"""

import argparse
import json
import sys
from pathlib import Path

import torch

from rigsmith_models.data.sampling import SAMPLINGS, Pool
from rigsmith_models.train.schedule import PLANS, Plan, next_due
from rigsmith_models.train.trainer import Run, Settings

RUNS = Path(__file__).parent / "runs"
UNBOUNDED = 10**7  # steps of a run that ends by the clock


def record_data(run: Run, pool: Pool) -> None:
    """Appends to the run's data.json what it is trained on from this step, and on which device, when that has changed."""
    path = run.folder / "data.json"
    history = json.loads(path.read_text()) if path.exists() else []
    now = {"characters": pool.counts(), "features": pool.features(), "device": run.device_name()}
    if not history or {k: history[-1].get(k) for k in now} != now:
        path.write_text(json.dumps([*history, {"from_step": run.step, **now}], indent=1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=[*PLANS, "due"])
    parser.add_argument("--data", nargs="+", type=Path, required=True, help="cache files made by rigsmith_models.data.prepare")
    parser.add_argument("--minutes", type=float, required=True, help="wall clock")
    parser.add_argument("--suffix", default="", help="of the folder under models/runs, after the network's name")
    parser.add_argument("--steps", type=int, help="length of the whole schedule; default: train/schedule.py")
    parser.add_argument("--width", type=float, default=Settings.width)
    parser.add_argument("--normalisation", default=Settings.normalisation, choices=("layer", "batch"))
    parser.add_argument("--rate", type=float, default=1.0, help="times the learning rate of train/schedule.py")
    parser.add_argument("--characters-per-step", type=int, default=Settings.characters_per_step)
    parser.add_argument("--real-share", type=float, default=Settings.real_share, help="of the draws; the others are generated characters")
    parser.add_argument("--seed", type=int, default=Settings.seed)
    parser.add_argument("--sampling", default=Settings.sampling, choices=SAMPLINGS)
    parser.add_argument("--as-they-are", action="store_true", help="no augmentation: what a network can learn by heart")
    parser.add_argument("--average-decay", type=float, default=Settings.average_decay)
    parser.add_argument("--by-clock", action="store_true", help="fit the schedule to the minutes, however many steps they hold")
    parser.add_argument("--then", metavar="NETWORK:MINUTES", help="and this one afterwards, on the same data")
    parser.add_argument("--workers", type=int, default=0, help="processes that make batches")
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
    pool = Pool(arguments.data)
    train(arguments, plan, arguments.minutes, device, pool)
    if arguments.then:
        network, minutes = arguments.then.split(":")
        train(arguments, PLANS[network], float(minutes), device, pool)


def train(arguments: argparse.Namespace, plan: Plan, minutes: float, device: str, pool: Pool) -> None:
    settings = Settings(
        network=plan.network, width=arguments.width, normalisation=arguments.normalisation,
        steps=arguments.steps or (UNBOUNDED if arguments.by_clock else plan.steps), learning_rate=plan.learning_rate * arguments.rate,
        characters_per_step=arguments.characters_per_step, seed=arguments.seed, real_share=arguments.real_share,
        sampling=arguments.sampling, augmented=not arguments.as_they_are, average_decay=arguments.average_decay,
    )
    name = plan.network + arguments.suffix
    run = Run(RUNS / name, settings, device, arguments.resume)
    if run.path.exists() and not arguments.resume:
        sys.exit(f"{run.path} exists; pass --resume to go on, or --suffix for another run")
    record_data(run, pool)
    run.train(pool, minutes, arguments.workers, arguments.by_clock)
    print(f"{name}: step {run.step} of {settings.steps}, {run.seconds / 60:.1f} CPU minutes in all")


if __name__ == "__main__":
    main()
