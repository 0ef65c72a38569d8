"""Draws region-map.png: where the high-gain observer is proven, with the published gain and with ours."""

from pathlib import Path

import numpy as np

from outrider import plots_design
from outrider.design import region


def main():
    made = region.map(region.shipped(), np.linspace(0.0, 10.0, 251), np.linspace(0.0, 6.0, 151))
    figure = plots_design.region_map(made)
    figure.savefig(Path(__file__).with_suffix(".png"), metadata={"Software": None})


if __name__ == "__main__":
    main()
