"""Build, installation into a clean environment, and first spectrum of the package.

    python benchmarks/installation.py [--pip]

Builds wheel and source distribution, compares their files with those that git tracks, installs each
into a separate environment, and prints the size of the installation, the time of ``import splits``,
and the time from the start of the installation to the first spectrum, including the compilation of
kernels.  Exits with status 1 if a file is missing, the installation is larger than its limit, or
the spectrum differs from that of the checkout.
"""

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
MAX_SIZE_MIB = 470
"""Largest size of an installation (MiB), without Python and compiled bytecode.

LLVM is 172 MiB and SciPy 113 MiB of it; this package is 4 MiB.
"""
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
    """Return the output of a command, or exit with its error message."""
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
    """Return the path of uv, beside this Python or on the search path."""
    found = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    return found or sys.exit("installation: needs uv (make setup brings it)")


def list_tracked_files() -> set[str]:
    """Return the files of the package that git tracks."""
    return set(run_command("git", "-C", ROOT, "ls-files", "splits").splitlines())


def build_distributions(folder: Path) -> tuple[Path, Path]:
    """Build wheel and source distribution, and return their paths."""
    run_command(find_uv(), "build", "--quiet", "--out-dir", folder, ROOT)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as file:
        in_wheel = set(file.namelist())
    with tarfile.open(source) as file:
        in_source = {name.partition("/")[2] for name in file.getnames()}
    for distribution, names in (("wheel", in_wheel), ("source distribution", in_source)):
        if missing := list_tracked_files() - names:
            sys.exit(f"installation: not in the {distribution}: {', '.join(sorted(missing))}")
    return wheel, source


def install(distribution: Path, folder: Path, by_pip: bool) -> Path:
    """Install a distribution into a new environment, and return the path of its Python."""
    python = folder / "bin" / "python"
    if by_pip:
        run_command(sys.executable, "-m", "venv", folder)
        run_command(python, "-m", "pip", "install", "--quiet", distribution)
    else:
        run_command(find_uv(), "venv", "--quiet", "--python", sys.executable, folder)
        run_command(find_uv(), "pip", "install", "--quiet", "--python", python, distribution)
    return python


def measure_size_mib(folder: Path, bytecode: bool) -> float:
    """Return the size of the files of an environment (MiB)."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    sizes = (path.stat().st_size for path in files if bytecode or path.suffix != ".pyc")
    return sum(sizes) / 2**20


def main() -> None:
    """Build and install the package, print sizes and times, and compare the spectrum."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pip", action="store_true", help="install with pip instead of uv")
    by_pip = parser.parse_args().pip
    with tempfile.TemporaryDirectory(prefix="splits-installation-") as name:
        folder = Path(name)
        wheel, source = build_distributions(folder / "dist")
        start = time.perf_counter()
        python = install(wheel, folder / "wheel", by_pip)
        installed = time.perf_counter()
        kernels = {"XDG_CACHE_HOME": str(folder / "cache")}
        spectrum = run_command(python, "-c", SPECTRUM_PROGRAM, **kernels).split()
        first = time.perf_counter()
        run_command(python, "-c", SPECTRUM_PROGRAM, **kernels)
        second = time.perf_counter()
        imports = [float(run_command(python, "-c", IMPORT_PROGRAM)) for _ in range(7)]
        size = measure_size_mib(folder / "wheel", False)
        print(f"{wheel.name}: {wheel.stat().st_size / 2**20:.2f} MiB")
        with_bytecode = measure_size_mib(folder / "wheel", True)
        print(f"installed: {size:.0f} MiB, {with_bytecode:.0f} with bytecode")
        print(f"import splits: {statistics.median(imports):.3f} s, median of {len(imports)}")
        print(
            f"from installation to a spectrum of {spectrum[2]} wavelengths: {first - start:.0f} s "
            f"({installed - start:.0f} installation, {first - installed:.0f} kernels and spectrum; "
            f"{second - first:.1f} in the next process)"
        )
        expected = run_command(sys.executable, "-c", SPECTRUM_PROGRAM, PYTHONPATH=str(ROOT)).split()
        if not spectrum[0].startswith(str(folder)) or spectrum[1:] != expected[1:]:
            sys.exit(f"installation: {spectrum} differs from that of the checkout: {expected}")
        source_python = install(source, folder / "source", by_pip)
        versions = run_command(source_python, "-m", "splits.cli", "versions")
        print(f"{source.name}: installs, version {versions}")
        if size > MAX_SIZE_MIB:
            sys.exit(f"installation: {size:.0f} MiB: must be at most {MAX_SIZE_MIB}")


if __name__ == "__main__":
    main()
