#!/bin/sh
# Trains whatever is farthest behind its share, in slices, until the time is over or nothing is due.
# Stop it at any moment; the same command goes on.
#   models/train_all.sh --minutes 90 CACHE/*.npz
set -eu
[ "$#" -ge 3 ] && [ "$1" = "--minutes" ] || { echo "usage: $0 --minutes N CACHE.npz..." >&2; exit 2; }
end=$(($(date +%s) + $2 * 60))
shift 2
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
folder=$(dirname "$0")
while [ "$(date +%s)" -lt "$end" ]; do
    left=$(((end - $(date +%s)) / 60 + 1))
    slice=$((left < 9 ? left : 9))
    "${PYTHON:-python}" "$folder/train.py" due --data "$@" --minutes "$slice" --resume || exit 0
done
