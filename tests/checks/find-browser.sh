#!/bin/sh
# Prints the path of a Chromium or Chrome. When there is none: installs Debian's as root, else says what to install.
set -e
find_browser() {
    for candidate in "$CHROMIUM" /usr/bin/chromium /usr/bin/chromium-browser /usr/bin/google-chrome; do
        if [ -n "$candidate" ] && [ -x "$candidate" ]; then
            echo "$candidate"
            return 0
        fi
    done
    return 1
}
find_browser && exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo 'installing Chromium for the three.js check' >&2
    apt-get update -qq >&2
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium </dev/null >&2
    find_browser && exit 0
fi
echo 'Chromium was not found: `apt-get install chromium`, or set CHROMIUM to the path of a Chrome or Chromium.' >&2
exit 1
