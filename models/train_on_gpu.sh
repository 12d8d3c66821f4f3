#!/bin/sh
# Trains the joint networks on one GPU within a given time, at half and at full width side by side, and sees how well 32 rigs are
# learnt by heart. Judges every minute's checkpoint on validation, and leaves in OUT what is worth keeping.
#   models/train_on_gpu.sh DATA OUT PAIR_MINUTES STAGE_MINUTES [further options of train.py]
# DATA holds travel files (rigsmith_models/data/travel.py): val.travel, mem.travel, and those to train on.
set -eu
[ "$#" -ge 4 ] || { echo "usage: $0 DATA OUT PAIR_MINUTES STAGE_MINUTES [OPTION...]" >&2; exit 2; }
data=$1 out=$2 pair=$3 stage=$4
shift 4
cd "$(dirname "$0")"
export OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
python=${PYTHON:-python3}
files=$(ls "$data"/*.travel | grep -v -e /val.travel -e /mem.travel)
limit=$(echo "$pair $stage" | awk '{ print int(60 * ($1 + $2)) + 50 }') # of the judges: what they cannot judge by then is judged at home
common="--by-clock --sampling dense --average-decay 0.999"

train() { # SUFFIX, options...
    suffix=$1; shift
    "$python" train.py rignet_joint_pair --suffix "$suffix" $common "$@" > "runs/log$suffix" 2>&1 &
    trainer=$!
}
judge() { # RUN, options...
    run=$1; shift
    timeout "$limit" "$python" judge_run.py "runs/$run" --process "$trainer" "$@" >> "runs/log_judges" 2>&1 &
}

mkdir -p runs
for form in half full; do
    [ "$form" = full ] && width=1 || width=0.5
    train "_$form" --data $files --minutes "$pair" --then "rignet_joint_stage:$stage" --characters-per-step 32 --rate 0.5 --width "$width" --workers 5 "$@"
    judge "rignet_joint_pair_$form" --on "val=$data/val.travel" --on "train=$data/train2.travel"
    judge "rignet_joint_stage_$form" --on "val=$data/val.travel" --on "train=$data/train2.travel"
done
train _memory --data "$data/mem.travel" --minutes "$pair" --characters-per-step 32 --rate 0.5 --width 1 --as-they-are --workers 2 "$@"
judge rignet_joint_pair_memory --on "mem=$data/mem.travel" --bandwidth 0.02 0.03 0.045 --reference-mask
wait

for form in half full; do
    cp "runs/rignet_joint_stage_$form/averages.pt" "$out/stage_$form.pt" || true
    cp "runs/rignet_joint_pair_$form/averages.pt" "$out/pair_$form.pt" || true
done
tar czf "$out/logs.tar.gz" runs/log* runs/*/*.jsonl runs/*/data.json
tail -n 3 runs/log* runs/rignet_joint_*/log.jsonl
for run in runs/rignet_joint_*; do echo "$run"; cut -c 1-150 "$run/judged.jsonl" | tail -n 8; done
