#!/usr/bin/env bash
# A whole fabric as one job, on a copy of its files on the node's own disk: for clusters whose shared file system is
# slow, or is not mounted where jobs run. In the folder of config.yaml:
#
#   sbatch --cpus-per-task 8 --mem 8000 --time 8:00:00 KINRAN/profiles/slurm/on_one_node.sh KINRAN FABRIC
#
# KINRAN is the clone of this project. What is finished comes back even when the run fails.
set -euo pipefail
kinran=$1 fabric=$2 home=$PWD
work=$(mktemp -d "${TMPDIR:-/tmp}/kinran.XXXXXX")
trap 'rm -rf "$work"' EXIT

mine=()
for part in "results/$fabric" "captures/$fabric" "logs/$fabric" .snakemake/metadata; do
  if [ -e "$part" ]; then mine+=("$part"); fi
done
# all that is not made by a run, then what was made of this fabric, with its times
tar -c --exclude ./results --exclude ./captures --exclude ./logs --exclude ./.snakemake . | tar -x -C "$work"
if [ ${#mine[@]} != 0 ]; then tar -c "${mine[@]}" | tar -x -C "$work"; fi
touch "$work/.copied"

cd "$work"
status=0
"$kinran/.venv/bin/snakemake" -s "$kinran/Snakefile" --cores "${SLURM_CPUS_PER_TASK:-1}" \
  "results/$fabric/report.html" || status=$?

# what is new: jobs of other fabrics may have written beside it meanwhile
find results captures logs .snakemake/metadata -newer .copied ! -type d -print0 2>/dev/null |
  tar -c --null --no-recursion --files-from - | tar -x -C "$home"
exit "$status"
