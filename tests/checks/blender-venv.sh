#!/bin/sh
# blender-venv.sh FOLDER: a Python 3.11 environment with Blender as a module in it (once; about 1 GB).
set -e
[ -f "$1/.installed" ] && exit 0
python=$(command -v python3.11 || command -v python3)
"$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' \
    || { echo 'Blender as a module (bpy 5.0.1) needs Python 3.11' >&2; exit 1; }
"$python" -m venv "$1"
"$1/bin/python" -m pip install --quiet --disable-pip-version-check bpy==5.0.1 numpy==1.26.4
touch "$1/.installed"
