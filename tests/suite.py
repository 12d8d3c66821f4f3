"""Runs everything that CI runs, step after step, and ends with one line: `N passed, N failed`.

A step that fails does not stop the next ones unless they need what it builds, so that one run tells all that is wrong.
Each step's output is shown as it comes and its own summary is counted: cargo's `test result: … N passed; N failed`,
pytest's and the checks' `N passed`, `N failed`; a step without a summary counts as one check. Needs only the standard
library. `make test` prepares what the steps stand on.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHON = "models/.venv/bin/python"
OUTPUTS = "target/checks/outputs"


@dataclass
class Step:
    name: str
    command: list[str]
    # Lines whose `N passed` and `N failed` count; none: the step itself is one check.
    summary: re.Pattern | None = None
    needs: list[str] = field(default_factory=list)


CARGO_SUMMARY = re.compile(r"^test result:")
PYTEST_SUMMARY = re.compile(r"^(=+ )?(\d+ (passed|failed|error|skipped|deselected|warning)s?,? ?)+.* in [\d.]+s")
CHECK_SUMMARY = re.compile(r": \d+ passed, \d+ failed$")

STEPS = [
    Step("formatting", ["cargo", "fmt", "--check"]),
    Step("lints", ["cargo", "clippy", "--release", "--all-targets", "--locked", "--", "-D", "warnings"]),
    # `--all-targets` builds the examples that the later steps run; documentation tests are a run of their own.
    Step("program", ["cargo", "build", "--release", "--locked", "--bins", "--examples"]),
    Step("tests", [PYTHON, "tests/postgres.py", "--", "cargo", "test", "--release", "--locked", "--no-fail-fast"],
         CARGO_SUMMARY),  # fmt: skip
    Step("Python tests", [PYTHON, "-m", "pytest", "-q", "models/tests", "tests/reliability"], PYTEST_SUMMARY),
    Step("Python client", [PYTHON, "tests/checks/python_client.py"], CHECK_SUMMARY, ["program"]),
    Step("Python package", [PYTHON, "-m", "pytest", "-q", "clients/python/tests"], PYTEST_SUMMARY, ["program"]),
    Step("stock gRPC client", [PYTHON, "tests/checks/stock_grpc.py"], CHECK_SUMMARY, ["program"]),
    Step("stock tus client", [PYTHON, "tests/checks/stock_tus.py"], CHECK_SUMMARY, ["program"]),
    Step("webhooks", [PYTHON, "tests/checks/webhooks.py"], CHECK_SUMMARY, ["program"]),
    Step("rigging of the cases", [PYTHON, "tests/checks/rig_cases.py", OUTPUTS], CHECK_SUMMARY, ["program"]),
    Step("skinning of parts", [PYTHON, "tests/checks/skin_cases.py", "target/checks/skin"], CHECK_SUMMARY, ["program"]),
    Step("glTF validator", ["node", "tests/checks/validate.mjs", OUTPUTS], CHECK_SUMMARY, ["program"]),
    Step("three.js", ["node", "tests/checks/threejs.mjs", OUTPUTS], CHECK_SUMMARY, ["program"]),
]


def count(word: str, line: str) -> int:
    return sum(int(number) for number in re.findall(rf"(\d+) {word}", line))


def run(step: Step) -> tuple[int, int]:
    """Runs `step`, echoing its output. Returns (passed, failed)."""
    print(f"\n== {step.name}: {' '.join(step.command)}", flush=True)
    environment = {**os.environ, "CARGO_TERM_COLOR": "never", "PYTHONDONTWRITEBYTECODE": "1"}
    passed = failed = 0
    try:
        process = subprocess.Popen(
            step.command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
        )  # fmt: skip
    except OSError as error:
        print(f"{step.command[0]} could not be started: {error}")
        return 0, 1
    for line in process.stdout:
        print(line, end="", flush=True)
        if step.summary and step.summary.search(line):
            passed += count("passed", line)
            failed += count("failed", line) + count("error", line)
    succeeded = process.wait() == 0
    if step.summary is None:
        return (1, 0) if succeeded else (0, 1)
    if not succeeded and failed == 0:  # it broke before its summary
        failed = 1
    return passed, failed


def main() -> int:
    started = time.monotonic()
    rows = []
    broken: set[str] = set()
    for step in STEPS:
        if broken.intersection(step.needs):
            rows.append((step.name, 0, 1, "not run: the program was not built"))
            continue
        step_started = time.monotonic()
        passed, failed = run(step)
        if failed:
            broken.add(step.name)
        rows.append((step.name, passed, failed, f"{time.monotonic() - step_started:.0f} s"))
    print(f"\n{'step':<24}{'passed':>8}{'failed':>8}  time")
    for name, passed, failed, note in rows:
        print(f"{name:<24}{passed:>8}{failed:>8}  {note}")
    passed = sum(row[1] for row in rows)
    failed = sum(row[2] for row in rows)
    print(f"in {time.monotonic() - started:.0f} s")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
