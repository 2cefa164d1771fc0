#!/usr/bin/env bash
# Installs the system packages that the viewer needs, and with the argument `tests` those that its
# tests need, too, and says which and why.
# Rust itself is expected to be there.
set -euo pipefail

needed=()
need() { # package, file that shows it is there, reason
    if ! compgen -G "$2" > /dev/null; then
        echo "needed: $1 ($3)"
        needed+=("$1")
    fi
}

need mesa-vulkan-drivers '/usr/share/vulkan/icd.d/*' \
    'a Vulkan driver: the viewer draws on the processor where there is no GPU'
need libxkbcommon-x11-0 '/usr/lib/*/libxkbcommon-x11.so.0' 'keys in the window of areoid view'
need libxcursor1 '/usr/lib/*/libXcursor.so.1' 'the pointer in that window'
need libxi6 '/usr/lib/*/libXi.so.6' 'buttons and wheels in that window'
if [ "${1-}" = tests ]; then
    need xvfb '/usr/bin/Xvfb' 'a display for the window that the tests drive'
    need vulkan-validationlayers '/usr/share/vulkan/explicit_layer.d/VkLayer_khronos_validation.json' \
        'tests hear what it says of how the window draws'
fi
need gcc '/usr/bin/cc' 'the linker that Rust calls'
need libc6-dev '/usr/include/stdio.h' 'what the linker links with'

if [ ${#needed[@]} -eq 0 ]; then
    echo "no system package is missing"
    exit 0
fi
if ! command -v apt-get > /dev/null; then
    echo "error: this is no Debian: install the packages above by hand, then run this again" >&2
    exit 1
fi
as_root=()
if [ "$(id -u)" -ne 0 ]; then
    as_root=(sudo)
fi
export DEBIAN_FRONTEND=noninteractive
install() {
    "${as_root[@]}" apt-get -o DPkg::Lock::Timeout=300 update -qq &&
        "${as_root[@]}" apt-get -o DPkg::Lock::Timeout=300 install -y -qq --no-install-recommends \
            "${needed[@]}"
}
install || { sleep 20 && install; }
