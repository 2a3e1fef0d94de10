#!/bin/sh
# CalculiX, which pip cannot install.  Installed where that needs no password; elsewhere
# one line says what is missing, and the benchmark's table says so too.
set -eu

command -v ccx >/dev/null 2>&1 && exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "bench-fem: no CalculiX (ccx), and no apt-get to install it with"
elif [ "$(id -u)" -ne 0 ]; then
    echo "bench-fem: no CalculiX; to install it: sudo apt-get install calculix-ccx"
elif ! { apt-get -qq update && DEBIAN_FRONTEND=noninteractive \
    apt-get -qq install --no-install-recommends calculix-ccx >/dev/null; }; then
    echo "bench-fem: no CalculiX, and apt-get could not install it"
fi
