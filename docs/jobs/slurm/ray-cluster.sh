#!/bin/bash
# Renders a job on a Ray cluster that this script starts on the nodes that Slurm gives it.
#
#   sbatch --nodes=4 --cpus-per-task=32 --time=8:00:00 docs/jobs/slurm/ray-cluster.sh JOB OUT [OPTION ...]
#
# JOB and OUT are as in `python -m factory render JOB --out OUT`; OUT lies on a file system that all
# nodes share at the same path. PYTHON names the interpreter (default: python3). Submit it again to
# continue: pictures that exist are not rendered twice.
#
# --no-kill lets the job go on when a node is lost: others make its pictures. If the first node is
# lost, on which the cluster's head and this script run, Slurm ends the job and queues it again.
#SBATCH --job-name=brdfactory
#SBATCH --ntasks-per-node=1
#SBATCH --exclusive
#SBATCH --no-kill
set -euo pipefail

if [ "$#" -lt 2 ]; then
    echo "usage: ray-cluster.sh JOB OUT [OPTION ...]" >&2
    exit 2
fi
job=$1 out=$2
shift 2
python=${PYTHON:-python3}
port=${RAY_PORT:-6379}
cpus=${SLURM_CPUS_PER_TASK:-$(nproc)}
export RAY_USAGE_STATS_ENABLED=0
export RAY_worker_niceness=0  # Ray's own 15 lets any other program of the node go first
# only this job's processes may use the cluster: srun hands the token on in the environment
export RAY_AUTH_MODE=token
RAY_AUTH_TOKEN=$(od -An -N32 -tx1 /dev/urandom | tr -d ' \n')
export RAY_AUTH_TOKEN

nodes=$(scontrol show hostnames "$SLURM_JOB_NODELIST")
head=$(echo "$nodes" | head -n 1)
# as Ray itself sees it: `hostname` may say 127.0.0.1
ip=$(srun --nodes=1 --ntasks=1 --nodelist="$head" "$python" -c \
    'import ray.util; print(ray.util.get_node_ip_address())')
address=$ip:$port

start=("$python" -m ray.scripts.scripts start --num-cpus="$cpus" --disable-usage-stats --block)
srun --nodes=1 --ntasks=1 --nodelist="$head" "${start[@]}" --head --port="$port" \
    --node-ip-address="$ip" --include-dashboard=false &
started=($!)
trap 'kill "${started[@]}" 2>/dev/null || true; wait' EXIT

for node in $(echo "$nodes" | tail -n +2); do
    srun --nodes=1 --ntasks=1 --nodelist="$node" "${start[@]}" --address="$address" &
    started+=($!)
done

# the head takes seconds to answer; a node that comes later is used from then on
for _ in $(seq 60); do
    if "$python" -m ray.scripts.scripts status --address="$address" >/dev/null 2>&1; then
        break
    fi
    sleep 2
done
"$python" -m factory render "$job" --out "$out" --ray "$address" "$@"
