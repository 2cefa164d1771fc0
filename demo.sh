#!/usr/bin/env bash
# Mars, end to end: four rasters into a catalog, and pictures out of it.
# Usage: ./demo.sh [FOLDER]   (default: out)
set -euo pipefail
cd "$(dirname "$0")"
out=${1:-out}

./setup.sh
cargo build --release
areoid=target/release/areoid
catalog="$out/mars"
mkdir -p "$out"

for raster in mola_height_8ppd.tif mola_north_polar_4km.tif mola_south_polar_4km.tif viking_color.jpg; do
    "$areoid" ingest "demo/mars/$raster" --catalog "$catalog"
done
"$areoid" info "$catalog"

# Vulkan's loader looks for a window system here, and complains on stderr if the variable is not set.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-${TMPDIR:-/tmp}}

picture() { # name, then the view
    local name=$1
    shift
    "$areoid" snapshot "$catalog" "$@" --size 1280x720 -o "$out/$name.png"
    echo "$out/$name.png"
}
picture disc --eye=-90,5,7400000 --target=-90,5 --sun=-110,20
picture olympus_mons --eye=-138,7,900000 --target=-133.8,17.6 --sun=-75,5 --fov-deg 30
picture valles_marineris --eye=-80,-24,1000000 --target=-69,-11.5 --sun=-15,5 --fov-deg 30
picture north_pole --eye=0,90,3000000 --target=0,90 --sun=60,40
picture south_pole --eye=0,-90,3000000 --target=0,-90 --sun=60,-40
