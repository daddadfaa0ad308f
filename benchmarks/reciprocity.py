"""Helmholtz reciprocity of dense media: f(i → r) against f(r → i), by interpretation.

    python benchmarks/reciprocity.py [--quick]

Prints, for every medium and interpretation, the relative difference of six pairs of directions and
its standard error, both in per cent.  Dilute grains are reciprocal (tests/physics).  Dense ones are
not if a grain that overlaps is rejected, and nearly so if it is skipped.
"""

import argparse

import numpy as np

import splits

ANGLE_PAIRS = ((0, 40, 0), (20, 70, 0), (20, 70, 180), (45, 75, 90), (60, 30, 180), (10, 80, 45))
"""Angle of incidence, viewing angle, azimuth from the forward direction (degrees)."""

KEEP_OVERLAPS = {"overlap_with_previous_segment": "keep", "overlap_with_boundary": "keep"}
SKIP_OVERLAPS = {"overlap_with_previous_segment": "skip", "overlap_with_boundary": "skip"}
INTERPRETATIONS = {
    "splits_2007": {},
    "entry projected": {"entry_point": "projected"},
    "all grains kept": KEEP_OVERLAPS,
    "skipped at boundaries": {"overlap_with_boundary": "skip"},
    "all skipped, entry projected": {**SKIP_OVERLAPS, "entry_point": "projected"},
    "the set geometric": {"set": "geometric"},
    "the set geometric, lobe": {"set": "geometric", "wrong_side_ray": "cosine_lobe"},
    "the set radiative_transfer": {"set": "radiative_transfer"},
    "the set radiative_transfer, lobe": {
        "set": "radiative_transfer",
        "wrong_side_ray": "cosine_lobe",
    },
}
MEDIA = {
    "snow of Table 1, dry, 1300 nm": (splits.Snow, {"saturation": 0.0}, 1300.0),
    "sand, base case of Fig 8, 600 nm": (splits.Sand, {}, 600.0),
}


def main() -> None:
    """Print one line per medium and interpretation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="larger error")
    error = 0.05 if parser.parse_args().quick else 0.012
    angles = sorted({angle for pair in ANGLE_PAIRS for angle in pair[:2]})
    azimuths = sorted({float(pair[2]) for pair in ANGLE_PAIRS})
    print("pairs (incidence, view, azimuth):", *ANGLE_PAIRS)
    for name, (kind, settings, wavelength) in MEDIA.items():
        for label, interpretation in INTERPRETATIONS.items():
            medium = kind(**settings, interpretation={"set": "splits_2007", **interpretation})
            runs = {
                angle: splits.goniophotometer(
                    medium,
                    [wavelength],
                    angle,
                    seed=angle,
                    relative_stderr=error,
                    polar_deg=angles,
                    azimuth_deg=azimuths,
                )
                for angle in angles
            }
            results = []
            for incidence, view, azimuth in ANGLE_PAIRS:
                forward = runs[incidence].sel(polar=view, azimuth=azimuth).isel(wavelength=0)
                reverse = runs[view].sel(polar=incidence, azimuth=azimuth).isel(wavelength=0)
                mean = 0.5 * float(forward.brdf + reverse.brdf)
                difference = float(forward.brdf - reverse.brdf) / mean
                stderr = float(np.hypot(forward.brdf_stderr, reverse.brdf_stderr)) / mean
                results.append(f"{100.0 * difference:+.1f} ± {100.0 * stderr:.1f}")
            print(f"{name}, {label}: {', '.join(results)}", flush=True)


if __name__ == "__main__":
    main()
