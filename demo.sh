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

picture() { # name, then the view
    local name=$1
    shift
    "$areoid" snapshot "$catalog" "$@" --size 1280x720 -o "$out/$name.png"
    echo "$out/$name.png"
}
picture disc --eye=-80,5,12000000 --target=-80,5 --sun=-130,20
picture olympus_mons --eye=-139.0,8.0,420000 --target=-133.8,18.6,8000 --sun=-170,35
picture valles_marineris --eye=-81.5,-18.5,420000 --target=-70.0,-11.5 --sun=-110,10
picture north_pole --eye=0,90,3600000 --target=0,90 --sun=60,35
picture south_pole --eye=0,-90,3600000 --target=0,-90 --sun=60,-35
