"""The package as a newcomer gets it: built, installed into a clean environment, one spectrum.

python benchmarks/installation.py [--pip]

Builds wheel and source distribution, compares what is in them with what git tracks, installs each
into an environment of its own, and prints how large that is, how long ``import splits`` takes, and
how long it takes from nothing to the first spectrum, kernels compiled on the way.  Ends with status
1 if a file is missing, the installation is above its bound, or the spectrum is not what the
checkout computes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_SIZE_MB = 350
"""MiB that an installation may take, Python itself and compiled bytecode left out."""
SPECTRUM_PROGRAM = """
import splits
snow = splits.Snow.natural(specific_surface_area_m2_kg=20)
ds = splits.spectrophotometer(snow, range(400, 2501, 10), max_stderr=0.01, seed=1)
print(splits.__file__, float(ds.reflectance.sel(wavelength=1000)), ds.sizes["wavelength"])
"""
IMPORT_PROGRAM = (
    "import time; t = time.perf_counter(); import splits; print(time.perf_counter() - t)"
)


def run_command(*command: object, **environment: str) -> str:
    """Return what a command prints, or end with what it says is wrong."""
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        env=variables | environment,
        cwd=tempfile.gettempdir(),
    )
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout.strip()


def find_uv() -> str:
    """Return where uv is: beside this Python, or on the path."""
    found = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    return found or sys.exit("installation: needs uv (make setup brings it)")


def list_tracked_files() -> set[str]:
    """Return the files of the package that git tracks."""
    return set(run_command("git", "-C", ROOT, "ls-files", "splits").splitlines())


def build_distributions(folder: Path) -> tuple[Path, Path]:
    """Build both distributions and return them: wheel and source."""
    run_command(find_uv(), "build", "--quiet", "--out-dir", folder, ROOT)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as file:
        in_wheel = set(file.namelist())
    with tarfile.open(source) as file:
        in_source = {name.partition("/")[2] for name in file.getnames()}
    for what, held in (("wheel", in_wheel), ("source distribution", in_source)):
        if missing := list_tracked_files() - held:
            sys.exit(f"installation: not in the {what}: {', '.join(sorted(missing))}")
    return wheel, source


def install(distribution: Path, folder: Path, by_pip: bool) -> Path:
    """Install a distribution into a new environment and return that environment's Python."""
    python = folder / "bin" / "python"
    if by_pip:
        run_command(sys.executable, "-m", "venv", folder)
        run_command(python, "-m", "pip", "install", "--quiet", distribution)
    else:
        run_command(find_uv(), "venv", "--quiet", "--python", sys.executable, folder)
        run_command(find_uv(), "pip", "install", "--quiet", "--python", python, distribution)
    return python


def measure_size_mib(folder: Path, bytecode: bool) -> float:
    """Return the size of what is installed in an environment (MiB)."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    sizes = (path.stat().st_size for path in files if bytecode or path.suffix != ".pyc")
    return sum(sizes) / 2**20


def main() -> None:
    """Build, install, measure, compare."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--pip", action="store_true", help="install with pip instead of uv")
    by_pip = options.parse_args().pip
    with tempfile.TemporaryDirectory(prefix="splits-installation-") as name:
        folder = Path(name)
        wheel, source = build_distributions(folder / "dist")
        begun = time.perf_counter()
        python = install(wheel, folder / "wheel", by_pip)
        ready = time.perf_counter()
        kernels = {"XDG_CACHE_HOME": str(folder / "cache")}
        spectrum = run_command(python, "-c", SPECTRUM_PROGRAM, **kernels).split()
        first = time.perf_counter()
        run_command(python, "-c", SPECTRUM_PROGRAM, **kernels)
        again = time.perf_counter()
        imports = [float(run_command(python, "-c", IMPORT_PROGRAM)) for _ in range(7)]
        size = measure_size_mib(folder / "wheel", False)
        print(f"{wheel.name}: {wheel.stat().st_size / 2**20:.2f} MiB")
        with_bytecode = measure_size_mib(folder / "wheel", True)
        print(f"installed: {size:.0f} MiB, {with_bytecode:.0f} with bytecode")
        print(f"import splits: {statistics.median(imports):.3f} s, median of {len(imports)}")
        print(
            f"from nothing to a spectrum of {spectrum[2]} wavelengths: {first - begun:.0f} s "
            f"({ready - begun:.0f} installation, {first - ready:.0f} kernels and spectrum; "
            f"{again - first:.1f} in the next process)"
        )
        here = run_command(sys.executable, "-c", SPECTRUM_PROGRAM, PYTHONPATH=str(ROOT)).split()
        if not spectrum[0].startswith(str(folder)) or spectrum[1:] != here[1:]:
            sys.exit(f"installation: {spectrum} is not what the checkout computes: {here}")
        other = install(source, folder / "source", by_pip)
        print(
            f"{source.name}: installs, version {run_command(other, '-m', 'splits.cli', 'versions')}"
        )
        if size > MAX_SIZE_MB:
            sys.exit(f"installation: {size:.0f} MiB: must be at most {MAX_SIZE_MB}")


if __name__ == "__main__":
    main()
