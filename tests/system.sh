#!/bin/sh
# Programs that tests drive and that pip cannot install: Chromium, for the page.
# Installed where that needs no password; elsewhere one line says what is missing,
# and the tests that need it say so too.
set -eu

for name in chromium chromium-browser google-chrome; do
    command -v "$name" >/dev/null 2>&1 && exit 0
done
if ! command -v apt-get >/dev/null 2>&1; then
    echo "system: no Chromium, and no apt-get to install it with"
elif [ "$(id -u)" -ne 0 ]; then
    echo "system: no Chromium; to install it: sudo apt-get install chromium"
elif ! { apt-get -qq update && DEBIAN_FRONTEND=noninteractive \
    apt-get -qq install --no-install-recommends chromium >/dev/null; }; then
    echo "system: no Chromium, and apt-get could not install it"
fi
