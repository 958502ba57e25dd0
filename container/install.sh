#!/bin/sh
# Installs what Kinran's jobs import, as pinned in the requirements beside this script. Both recipes of an image run it.
set -eu
cd "$(dirname "$0")"
apt-get update -qq
# Python, and the system libraries that ./kinran installs
apt-get install -y -qq --no-install-recommends ca-certificates python3 python3-venv \
  libgl1 libopengl0 libatomic1 libllvm19
rm -rf /var/lib/apt/lists/*
python3 -m venv /opt/kinran
/opt/kinran/bin/pip install --no-cache-dir --require-hashes -r requirements-uv.txt
/opt/kinran/bin/uv pip install --no-cache --python /opt/kinran/bin/python --require-hashes \
  -r requirements.txt -r requirements-slurm.txt
