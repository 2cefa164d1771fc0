#!/usr/bin/env python3
"""Writes proj.csv: what PROJ says about the projections and surfaces that Areoid has its own code for.

    pip install pyproj==3.7.2        # brings PROJ 9.5.1, which made the committed table
    python3 make_proj.py > proj.csv

Columns: kind, system, lon_deg, lat_deg, height_m, x, y, z. Latitudes are planetographic. By kind:

    map      system is a PROJ string; x, y are its map coordinates (meters, degrees for longlat)
    centric  the same, of a sphere whose latitudes are planetocentric on the ellipsoid of Mars
    latitude system is a surface; y is the planetocentric latitude in degrees
    cart     system is a surface; x, y, z are body-fixed meters

Systems with an EPSG code are computed from the code and written as a PROJ string, so that the
string is checked too.
"""

import random
import sys

from pyproj import CRS, Transformer

MARS = "+R=3396190"
MARS_ELLIPSOID = "+a=3396190 +b=3376200"
TAIL = "+units=m +no_defs"


def eqc(lon_0, lat_ts, lat_0=0, x_0=0, y_0=0, surface=MARS):
    return (f"+proj=eqc +lat_ts={lat_ts} +lat_0={lat_0} +lon_0={lon_0} "
            f"+x_0={x_0} +y_0={y_0} {surface} {TAIL}")


def stere(lat_0, scale, surface, lon_0=0, origin=0):
    return (f"+proj=stere +lat_0={lat_0} {scale} +lon_0={lon_0} "
            f"+x_0={origin} +y_0={origin} {surface} {TAIL}")


# PROJ string -> EPSG code, or None where PROJ computes from the string itself.
MAPS = {
    f"+proj=longlat {MARS} +no_defs": None,
    eqc(0, 0): None,
    eqc(180, 0): None,
    eqc(-77.5, 35): None,
    eqc(270, -60, 10, 1e6, -5e5): None,
    eqc(30, 45, 0, 0, 0, MARS_ELLIPSOID): None,
    stere(90, "+k=1", MARS): None,
    stere(-90, "+k=1", MARS): None,
    stere(90, "+lat_ts=60", MARS, 137): None,
    stere(-90, "+lat_ts=-75", MARS, 180): None,
    stere(90, "+k=1", MARS_ELLIPSOID): None,
    stere(-90, "+lat_ts=-71", "+datum=WGS84"): 3031,
    stere(90, "+lat_ts=70", "+datum=WGS84", -45): 3413,
    stere(90, "+k=0.994", "+datum=WGS84", 0, 2000000): 5041,
    stere(-90, "+k=0.994", "+datum=WGS84", 0, 2000000): 5042,
}

CENTRIC = [eqc(0, 0), eqc(180, 40), stere(90, "+k=1", MARS), stere(-90, "+lat_ts=-70", MARS)]
SURFACES = ["+datum=WGS84", MARS_ELLIPSOID, MARS]
HEIGHTS = [-1e5, -1e4, 0.0, 8848.0, 4e5, 3.6e7, 1e9]


def positions(rng):
    """Poles and their neighbourhoods, the antimeridian, odd turns of longitude, and the many."""
    for sign in (1, -1):
        for off in (0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-1):
            for lon in (-135.0, 0.0, 77.7):
                yield lon, sign * (90 - off)
    for lon in (-180.0, -180 + 1e-9, 180 - 1e-9, 180 - 1e-3, -180 + 1e-3, 0.0, 90.0, -90.0):
        for lat in (-79.5, -45.0, 0.0, 30.0, 60.0, 85.0):
            yield lon, lat
    for lon in (180.0, 190.0, 270.5, 359.999999, 360.0, 540.0, -190.0, -360.0):
        yield lon, rng.uniform(-75, 75)
    for _ in range(24):
        yield rng.uniform(-180, 180), rng.uniform(-79.9, 79.9)
    for _ in range(10):
        yield rng.uniform(-180, 180), rng.choice((1, -1)) * rng.uniform(80, 90)


def in_domain(system, lat):
    """A polar map ends 10 degrees before the other pole."""
    sign = 1 if "+lat_0=90" in system else -1 if "+lat_0=-90" in system else 0
    return sign * lat > -80


def row(kind, system, lon, lat, height, *xyz):
    cells = [kind, system, repr(lon), repr(lat), repr(height), *(repr(float(v)) for v in xyz)]
    cells += [""] * (8 - len(cells))
    print(",".join(cells))


def pipeline(*steps):
    return Transformer.from_pipeline("+proj=pipeline " + " ".join(f"+step {s}" for s in steps))


def main():
    radians = "+proj=unitconvert +xy_in=deg +xy_out=rad"
    print("kind,system,lon_deg,lat_deg,height_m,x,y,z")
    rng = random.Random(2008)

    for system, code in MAPS.items():
        target = CRS.from_epsg(code) if code else CRS.from_proj4(system)
        transformer = Transformer.from_crs(target.geodetic_crs, target, always_xy=True)
        for lon, lat in positions(rng):
            if in_domain(system, lat):
                row("map", system, lon, lat, 0.0, *transformer.transform(lon, lat))

    for system in CENTRIC:
        bare = system.replace(" +no_defs", "")
        transformer = pipeline(radians, f"+proj=geoc {MARS_ELLIPSOID}", bare)
        for lon, lat in positions(rng):
            # PROJ takes latitudes this near to a pole as they are.
            if in_domain(system, lat) and (abs(lat) == 90 or abs(lat) < 90 - 1e-7):
                row("centric", system, lon, lat, 0.0, *transformer.transform(lon, lat))

    for system in SURFACES:
        surface = system.replace("datum", "ellps")
        degrees = "+proj=unitconvert +xy_in=rad +xy_out=deg"
        transformer = pipeline(radians, f"+proj=geoc {surface}", degrees)
        for lon, lat in positions(rng):
            if lon == 0.0 and (abs(lat) == 90 or abs(lat) < 90 - 1e-7):
                row("latitude", system, lon, lat, 0.0, *transformer.transform(lon, lat))

    for system in SURFACES:
        transformer = pipeline(radians, f"+proj=cart {system.replace('datum', 'ellps')}")
        for i, (lon, lat) in enumerate(positions(rng)):
            height = HEIGHTS[i % len(HEIGHTS)]
            row("cart", system, lon, lat, height, *transformer.transform(lon, lat, height))


if __name__ == "__main__":
    sys.exit(main())
