"""Make the shipped proofs anew and compare: `python -m benchmarks.certificates [--write] [NAME ...]`.

Needs outrider[design]. Designed gains must come out as they stand in the observers' files, within TOLERANCE,
proven bounds within BOUNDS of the shipped ones; exit code 1 where they do not, or where a shipped file does
not prove what it claims.
"""

from __future__ import annotations

import argparse
import sys
import time

from benchmarks.certificates import ALL, BOUNDS, TOLERANCE

from outrider import proof_file
from outrider.errors import OutriderError
from outrider.observers import certificate_of


def main() -> int:
    """A line for each; 1 where something does not agree or is not proven."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split(": `")[0])
    parser.add_argument("names", nargs="*", help=f"of: {', '.join(s.name for s in ALL)}; all where none")
    parser.add_argument("--write", action="store_true", help="replace the shipped files")
    given, wrong = parser.parse_args(), 0
    for s in ALL:
        if given.names and s.name not in given.names:
            continue
        begin = time.perf_counter()
        try:
            if given.write and (file := s.proven().file):
                proof_file.write(file, proof_file.SHIPPED / f"{s.name}.json")
            gains, bounds = s.off(), 0.0 if given.write else s.bounds_off()
            proof = certificate_of(proof_file.shipped(s.name))
        except OutriderError as error:
            wrong += 1
            print(f"{s.name}: {error}")
            continue
        wrong += gains > TOLERANCE or bounds > BOUNDS or not proof.proven()
        print(
            f"{s.name:28} gains off by {100 * gains:.3f} %, bounds by {100 * bounds:.2f} %, shipped margin "
            f"{proof.margin():.1e}, {time.perf_counter() - begin:.1f} s"
        )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
