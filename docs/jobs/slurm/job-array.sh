#!/bin/bash
# Renders a job as a Slurm job array, one part for each task, without Ray.
#
#   sbatch --array=1-8 --cpus-per-task=32 --time=8:00:00 docs/jobs/slurm/job-array.sh JOB OUT [OPTION ...]
#
# All tasks write into OUT, which lies on a shared file system. The array begins at 1 and has no
# gaps. Submit the same array again to continue or to repeat tasks that were lost: pictures that
# exist are not rendered twice. PYTHON names the interpreter (default: python3).
#
# A task reads only the shapes of its part and begins with the first one, if the job has at least
# as many shapes as the array has tasks; docs/clusters.md names the cases in which it reads all.
#SBATCH --job-name=brdfactory
#SBATCH --ntasks=1
set -euo pipefail

if [ "$#" -lt 2 ]; then
    echo "usage: job-array.sh JOB OUT [OPTION ...]" >&2
    exit 2
fi
job=$1 out=$2
shift 2
if [ "${SLURM_ARRAY_TASK_MIN:-}" != 1 ] ||
    [ "${SLURM_ARRAY_TASK_MAX:-}" != "${SLURM_ARRAY_TASK_COUNT:-none}" ]; then
    echo "job-array.sh: give --array=1-N, from 1 and without gaps" >&2
    exit 2
fi
exec "${PYTHON:-python3}" -m factory render "$job" --out "$out" \
    --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" \
    --workers "${SLURM_CPUS_PER_TASK:-1}" "$@"
