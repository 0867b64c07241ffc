"""Profile-guided build of the virtual board: faster until a source changes; results differ in the last bits only.

The compiler is the newest clang >= 19 that can link a profile (10 % faster than gcc 12), else gcc, or ``CC`` of the
environment if set. ``SERVO_TWIN_FLAGS`` are the flags of the normal build.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).resolve().parents[2] / "servo_twin"
CLANG_VERSIONS: Final = (22, 21, 20, 19)
LEVELS: Final = ("ideal", "registers")

# Vector code is slower here. Valgrind reads only the older debug format of such a clang.
_CLANG: Final = [
    "-O3",
    "-gdwarf-4",
    "-fno-vectorize",
    "-fno-slp-vectorize",
    "-fuse-ld=lld",
    "-Wno-unused-command-line-argument",
]
# With gcc the use of a profile enables vector code again, so it is disabled here too.
_GCC: Final = [
    "-fprofile-partial-training",
    "-Wno-missing-profile",
    "-fno-tree-loop-vectorize",
    "-fno-tree-slp-vectorize",
]
# FMA shortens the dependency chains of a segment: 3 to 5 % faster, different last bits.
_FMA: Final = ["-mfma", "-ffp-contract=fast"]


@dataclass(frozen=True)
class Build:
    """Build with one compiler and one profile."""

    clang: int | None  # version of clang; None: compiler of the environment, treated as gcc
    profile: Path  # absolute path of the folder of the profile

    def record(self) -> None:
        """Compile an instrumented board and run it at both levels."""
        by_compiler = _CLANG if self.clang else ["-fprofile-update=single"]
        self._compile("for a profile", [f"-fprofile-generate={self.profile}", *by_compiler])
        environment = {name: value for name, value in os.environ.items() if name != "LLVM_PROFILE_FILE"}
        tool = str(Path(sys.executable).with_name("servo-sim"))
        for level in LEVELS:
            command = [tool, "bench", "--level", level, "--time", "1"]
            subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
        if self.clang:
            files = sorted(map(str, self.profile.glob("*.profraw")))
            subprocess.run([f"llvm-profdata-{self.clang}", "merge", f"--output={self._merged}", *files], check=True)

    def use(self) -> None:
        """Compile with the recorded profile."""
        if self.clang:
            self._compile("with it", [f"-fprofile-use={self._merged}", *_CLANG])
        else:
            self._compile("with it", [f"-fprofile-use={self.profile}", *_GCC])

    @property
    def _merged(self) -> Path:
        return self.profile / "all"

    def _compile(self, purpose: str, flags: list[str]) -> None:
        environment = dict(os.environ)
        ordinary = environment.get("SERVO_TWIN_FLAGS", "").split()
        flags = [*ordinary, *(_FMA if "-mno-fma" in ordinary else []), *flags]
        if self.clang:
            environment["CC"] = f"clang-{self.clang}"
        print(f"compiling firmware and virtual board {purpose}, with {environment.get('CC', 'cc')}", flush=True)
        environment["SERVO_TWIN_FLAGS"] = " ".join(flags)
        command = [sys.executable, "-W", "ignore", "setup.py", "--quiet", "build_ext", "--inplace", "--force"]
        subprocess.run(command, cwd=PACKAGE, env=environment, check=True)


def newest_clang() -> int | None:
    """Version of the newest clang that can link an instrumented program; None if there is none."""
    for version in CLANG_VERSIONS:
        if shutil.which(f"llvm-profdata-{version}") and shutil.which(f"clang-{version}"):
            command = [
                f"clang-{version}",
                "-x",
                "c",
                "-fuse-ld=lld",
                "-flto",
                "-fprofile-generate",
                "-o",
                "/dev/null",
                "-",
            ]
            if subprocess.run(command, input=b"int main(void) { return 0; }", capture_output=True).returncode == 0:
                return version
    return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--profile", type=Path, default=Path(".venv/profile"), help="folder; its content is replaced")
    parser.add_argument("--clang", type=int, help="version of clang; 0 for the compiler of the environment")
    options = parser.parse_args()
    clang = options.clang
    if clang is None and "CC" not in os.environ:
        clang = newest_clang()
    profile = options.profile.resolve()
    shutil.rmtree(profile, ignore_errors=True)
    build = Build(clang or None, profile)
    build.record()
    build.use()


if __name__ == "__main__":
    main()
