"""Puts ONNX Runtime's shared library into third_party/onnxruntime/, once.

The library comes out of the published Python wheel (onnxruntime-requirements.txt pins its digest), because that is the
one build of it for every platform with licence texts beside it. Nothing is fetched when the library is already there
with the digest below. Needs Python 3.9 or newer and its pip; the wheel's own Python version does not matter, since only
the shared library is used.
"""

from __future__ import annotations

import argparse
import hashlib
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = Path(__file__).resolve().parent / "onnxruntime-requirements.txt"
TARGET = ROOT / "third_party" / "onnxruntime"
# One file name on every platform, which .cargo/config.toml names; macOS gets a link with the usual name beside it.
LIBRARY = TARGET / "libonnxruntime.so"
MACOS_NAME = TARGET / "libonnxruntime.dylib"
NOTICES = ("LICENSE", "ThirdPartyNotices.txt")

# (system, machine) -> (pip's platform tag, the library's name in the wheel, the library's sha256)
PLATFORMS = {
    ("Linux", "x86_64"): (
        "manylinux_2_28_x86_64",
        "onnxruntime/capi/libonnxruntime.so.1.31.1",
        "fc44112fbe06d7d689c57e11d3862031f64711007e4ee020f8eed5185fd2c1d3",
    ),
    ("Linux", "aarch64"): (
        "manylinux_2_28_aarch64",
        "onnxruntime/capi/libonnxruntime.so.1.31.1",
        "8aa3b76b28c778a2b1dd660d34161adb1d508c9ccd04ff9dc80e26eca5df8467",
    ),
    ("Darwin", "arm64"): (
        "macosx_14_0_arm64",
        "onnxruntime/capi/libonnxruntime.1.31.1.dylib",
        "d586cbe89effc085a09d3341b3cfbd5c322517f9d397aeb20814af21433f2b36",
    ),
}


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() if hasattr(hashlib, "file_digest") else (
            hashlib.sha256(file.read()).hexdigest()
        )


def download(platform_tag: str, folder: Path) -> Path:
    """Lets pip download the pinned wheel (and refuse any other) into `folder`."""
    # fmt: off
    command = [
        sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--only-binary=:all:", "--implementation", "cp", "--python-version", "3.12", "--abi", "cp312",
        "--platform", platform_tag, "--require-hashes", "-r", str(REQUIREMENTS), "-d", str(folder),
    ]
    # fmt: on
    try:
        subprocess.run(command, check=True)
    except subprocess.CalledProcessError:
        sys.exit(
            "ONNX Runtime could not be downloaded (pip's message is above). Without pip: `apt-get install python3-pip`. "
            "Without a network: download the wheel elsewhere and run `make ort WHEEL=path/to/onnxruntime-….whl`."
        )
    (wheel,) = folder.glob("onnxruntime-*.whl")
    return wheel


def unpack(wheel: Path, member: str, expected_sha256: str) -> None:
    """Takes the library and the licence texts out of `wheel`; the library appears whole and checked, or not at all."""
    TARGET.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        for notice in NOTICES:
            (TARGET / notice).write_bytes(archive.read(f"onnxruntime/{notice}"))
        unchecked = LIBRARY.with_suffix(".unchecked")
        unchecked.write_bytes(archive.read(member))
    found = sha256(unchecked)
    if found != expected_sha256:
        unchecked.unlink()
        sys.exit(f"{wheel.name} holds a {member} with digest {found}, not {expected_sha256}: it was not installed.")
    unchecked.replace(LIBRARY)
    if member.endswith(".dylib") and not MACOS_NAME.is_symlink():
        MACOS_NAME.symlink_to(LIBRARY.name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wheel", type=Path, help="use this wheel in place of a download")
    arguments = parser.parse_args()

    host = (platform.system(), platform.machine())
    if host not in PLATFORMS:
        known = ", ".join(f"{system} {machine}" for system, machine in PLATFORMS)
        sys.exit(f"No ONNX Runtime is pinned for {host[0]} {host[1]}; there is one for {known}.")
    platform_tag, member, expected_sha256 = PLATFORMS[host]

    if LIBRARY.is_file() and sha256(LIBRARY) == expected_sha256:
        print(f"ONNX Runtime 1.31.1 is in place: {LIBRARY.relative_to(ROOT)}")
        return
    with tempfile.TemporaryDirectory() as folder:
        wheel = arguments.wheel or download(platform_tag, Path(folder))
        unpack(wheel, member, expected_sha256)
    print(f"ONNX Runtime 1.31.1 installed: {LIBRARY.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
