"""The region map: the papers' figures, what must hold of any such map, refusals, and the picture."""

from pathlib import Path

import numpy as np
import pytest

from outrider import family, plots_design
from outrider.design import region
from outrider.errors import InputError, NotCertified, OutputError

pytestmark = pytest.mark.once

GAINS = region.shipped()
PUBLISHED, OURS = GAINS["published"], GAINS["ours"]
PRINTED = (78.83, 914.6, -2215.8)  # what the K printed beside it would give
SPEEDS, ACCELERATIONS = np.linspace(0.0, 10.0, 41), np.linspace(0.0, 6.0, 31)


@pytest.fixture(scope="module")
def made() -> region.Map:
    return region.map(GAINS, SPEEDS, ACCELERATIONS, step=0.05, count=20)


# ---------------------------------------------------------------- the figures that are quoted


@pytest.mark.parametrize(
    ("speed", "acceleration", "box", "tight"),
    [(2.0, 1.0, 1.9, 2.3), (5.0, 3.0, 1.7, 2.1), (1.0, 1.0, 0.7, 1.3)],
)
def test_the_published_gain_is_proven_as_far_as_quoted(
    speed: float, acceleration: float, box: float, tight: float
) -> None:
    """E3: on a grid of 0.2 rad/s, with the 32 corners of the box and with the 16 of the tighter hull."""
    ratio = acceleration / speed
    assert box <= region.largest_yaw_rate(PUBLISHED, ratio, step=0.1, hull="box") < box + 0.2
    assert tight <= region.largest_yaw_rate(PUBLISHED, ratio, step=0.1) < tight + 0.2


def test_the_map_holds_the_quoted_points(made: region.Map) -> None:
    """At their own ratio, as exactly as a search of its own; between two ratios it says a little less."""
    edge = made.edges["published"]
    for speed, acceleration, least in ((2.0, 1.0, 2.3), (5.0, 3.0, 2.1), (1.0, 1.0, 1.3)):
        found = region.largest_yaw_rate(PUBLISHED, acceleration / speed, step=0.05)
        assert least <= edge.at(speed, acceleration) == found < least + 0.2
        i, j = np.searchsorted(ACCELERATIONS, acceleration), np.searchsorted(SPEEDS, speed)
        assert made.yaw_rates["published"][i, j] == found
    for ratio in (0.13, 0.55, 0.97):
        found = region.largest_yaw_rate(PUBLISHED, ratio, step=0.05)
        assert found - 0.2 < edge.at(1.0, ratio) <= found
    assert np.isnan(edge.at(2.0, 3.0))


def test_the_refused_region_names_its_eigenvalue(made: region.Map) -> None:
    text = r"no proof can exist: .* acceleration / speed 1\.5 1/s .* eigenvalue \+0\.7509.* 2 m/s, .* 3 m/s2"
    with pytest.raises(NotCertified, match=text):
        made.edges["published"].certificate(2.0, 3.0)
    found = region.reach(PUBLISHED, 1.5)
    assert np.isnan(found.yaw_rate)
    assert found.certificate is None
    assert "eigenvalue +0.7509" in found.refusal
    r, L1, L2, L3 = 1.5, *PUBLISHED
    across = [1.0, L1 - 3.0 * r, L2 - 3.0 * r * L1 + 3.0 * r * r, L3 - 3.0 * r * L2 + 3.0 * r * r * L1]
    assert np.roots(across).real.max() == pytest.approx(0.7509, abs=1e-4)


@pytest.mark.parametrize("gain", [PUBLISHED, OURS])
def test_straight_motion_is_unstable_from_the_root_of_the_constant_term(gain: tuple[float, ...]) -> None:
    L1, L2, L3 = gain
    closed = min(np.roots([3.0 * L1, -3.0 * L2, L3]).real)
    assert region.frozen_limit(gain) == pytest.approx(closed, rel=1e-9)
    assert region.frozen_limit(PUBLISHED) == pytest.approx(1.27, abs=5e-3)
    slower = region.frozen_limit(gain, 0.5)
    poles = np.linalg.eigvals(family.frozen_high_gain(gain, 1.0, slower, 0.0).matrices)
    assert poles.real.max() == pytest.approx(-0.5, abs=1e-6)
    assert slower < closed


# ---------------------------------------------------------------- what holds of any map


def test_every_number_stands_on_a_certificate(made: region.Map) -> None:
    for edge in made.edges.values():
        assert len(edge.certificates) == len(edge.ratio) == 23
        for r, k, proof in zip(edge.ratio, edge.yaw_rate, edge.certificates, strict=True):
            assert proof is not None
            assert proof.proven()
            assert len(proof.matrices) == 16
            high = proof.region["course rate [rad/s]"][1], proof.region["acceleration / speed [1/s]"][1]
            assert high[0] == pytest.approx(k)
            assert high[1] >= r - 1e-12


def test_a_certificate_holds_at_every_state_of_its_region(made: region.Map) -> None:
    """Also at those that are no corner: P shrinks along the true Jacobian."""
    rng = np.random.default_rng(5)
    for name, edge in made.edges.items():
        proof = edge.certificate(5.0, 3.0)
        K, R = (proof.region[of][1] for of in ("course rate [rad/s]", "acceleration / speed [1/s]"))
        states = rng.uniform(-1.0, 1.0, (200, 2)) * [K, R]
        A = family._closed(
            np.array([family._companion(k, r, k * k, k * r, r * r) for k, r in states]), GAINS[name]
        )
        grown = A.transpose(0, 2, 1) @ proof.P + proof.P @ A
        assert np.linalg.eigvalsh(grown).max() < 0.0
        assert np.linalg.eigvalsh(proof.P).min() > 0.0


def test_a_larger_region_is_never_easier(made: region.Map) -> None:
    for edge in made.edges.values():
        assert (np.diff(edge.yaw_rate) <= 0.0).all()
        assert (np.diff(edge.ratio) > 0.0).all()
    for values in made.yaw_rates.values():
        known = np.nan_to_num(values, nan=-1.0)
        assert (np.diff(known, axis=0) <= 0.0).all()  # more acceleration
        assert (np.diff(known, axis=1) >= 0.0).all()  # only faster ones
    fast, slow = (region.largest_yaw_rate(OURS, 0.5, rate) for rate in (1.0, 0.5))
    assert 0.0 < fast < slow < made.edges["ours"].at(2.0, 0.9)


def test_a_certificate_serves_the_smaller_boxes() -> None:
    """Their corners lie in the hull of the larger one's, so the same P proves them."""
    found = region.reach(PUBLISHED, 0.8, step=0.1)
    assert found.certificate is not None
    rng = np.random.default_rng(2)
    for share, part in rng.uniform(0.0, 1.0, (20, 2)):
        A = family.high_gain(PUBLISHED, 1.0, 0.8 * share, found.yaw_rate * part).matrices
        P = found.certificate.P
        assert np.linalg.eigvalsh(A.transpose(0, 2, 1) @ P + P @ A).max() < 0.0


def test_only_the_ratio_counts(made: region.Map) -> None:
    rng = np.random.default_rng(3)
    for V, A, K, factor in rng.uniform(0.1, 5.0, (20, 4)):
        one, other = (family.high_gain(OURS, c * V, c * A, K).matrices for c in (1.0, factor))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
        edge = made.edges["ours"]
        np.testing.assert_array_equal(edge.at(V, A), edge.at(factor * V, factor * A))


def test_no_proof_is_found_where_none_can_exist(made: region.Map) -> None:
    for edge in made.edges.values():
        assert (edge.yaw_rate < edge.frozen).all()
        for r, k in zip(edge.ratio[::5], edge.frozen[::5], strict=True):
            frozen = [family.frozen_high_gain(edge.gain.tolist(), 1.0, r, K).matrices for K in (k - 0.05, k)]
            before, after = (np.linalg.eigvals(A).real.max() for A in frozen)
            assert before < 0.0 <= after


def test_halving_between_ratios_finds_what_a_search_of_its_own_finds(made: region.Map) -> None:
    for name, edge in made.edges.items():
        for i in (0, 7, 13, 19):
            assert region.largest_yaw_rate(GAINS[name], edge.ratio[i], step=0.05) == edge.yaw_rate[i]


def test_the_published_gain_is_proven_further_and_ours_where_it_was_designed(made: region.Map) -> None:
    """Ours has a quarter of the gain on the position, which is what it was made for."""
    ours, theirs = (np.nan_to_num(made.yaw_rates[name], nan=-1.0) for name in ("ours", "published"))
    assert (ours <= theirs).all()
    assert (ours[theirs >= 0.0] >= 0.0).mean() > 0.8
    assert region.largest_yaw_rate(OURS, 3.0 / 5.0, rate=0.5) >= 0.4


# ---------------------------------------------------------------- refusals


def test_an_unstable_gain_has_an_empty_map() -> None:
    made = region.map({"printed": PRINTED}, SPEEDS, ACCELERATIONS)
    assert np.isnan(made.yaw_rates["printed"]).all()
    assert made.edges["printed"].limit == 0.0
    with pytest.raises(NotCertified, match=r"no proof can exist: .*eigenvalue \+2\."):
        made.edges["printed"].certificate(5.0, 0.0)
    figure = plots_design.region_map(made)
    assert [text.get_text() for text in figure.axes[0].texts].count("none") == len(region.QUOTED)


def test_standstill_has_no_proof(made: region.Map) -> None:
    edge = made.edges["published"]
    assert np.isnan(edge.at(0.0, [0.0, 1.0])).all()
    with pytest.raises(InputError, match="no proof reaches standstill"):
        edge.certificate(0.0, 1.0)


def test_next_to_the_limit_the_table_ends(made: region.Map) -> None:
    edge = made.edges["published"]
    last, limit = edge.ratio[-1], edge.limit
    assert np.isnan(edge.at(1.0, 0.5 * (last + limit)))
    with pytest.raises(NotCertified, match="too close to this table's limit"):
        edge.certificate(1.0, 0.5 * (last + limit))


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: region.largest_yaw_rate([1.0, 2.0], 0.5), "want three finite numbers"),
        (lambda: region.largest_yaw_rate([67.2, np.nan, 2818.5], 0.5), "want three finite numbers"),
        (lambda: region.largest_yaw_rate(PUBLISHED, -0.1), "want 0 or more"),
        (lambda: region.largest_yaw_rate(PUBLISHED, np.inf), "no proof reaches standstill"),
        (lambda: region.largest_yaw_rate(PUBLISHED, 0.5, rate=-1.0), "want a rate of 0 or more"),
        (lambda: region.largest_yaw_rate(PUBLISHED, 0.5, step=0.0), "a step above 0"),
        (lambda: region.map({}, SPEEDS, ACCELERATIONS), "a map of no gain"),
        (lambda: region.map(GAINS, [-1.0, 1.0], ACCELERATIONS), "speeds of the map from -1; want 0 or more"),
        (lambda: region.map(GAINS, SPEEDS, [3.0, 1.0]), "accelerations .* each above the one before"),
        (lambda: region.map(GAINS, [1.0], ACCELERATIONS), "want two or more"),
        (lambda: region.map(GAINS, [1.0, np.inf], ACCELERATIONS), "finite"),
    ],
)
def test_what_is_no_region_is_refused(call: object, text: str) -> None:
    with pytest.raises(InputError, match=text):
        call()  # type: ignore[operator]


# ---------------------------------------------------------------- the picture


def test_the_picture_says_what_it_shows(made: region.Map, tmp_path: Path) -> None:
    figure = plots_design.region_map(made)
    published, ours, *_ = figure.axes
    assert published.get_title(loc="left") == "published: L = 67.2, 823.1, 2818.5"
    assert ours.get_title(loc="left") == f"ours: L = {', '.join(f'{g:g}' for g in OURS)}"
    assert published.get_xlabel() == "speed from [m/s]"
    assert published.get_ylabel() == "|acceleration| up to [m/s²]"
    for ax, name in ((published, "published"), (ours, "ours")):
        limit = f"{made.edges[name].limit:.2f}"
        said = [text.get_text() for text in ax.texts]
        for speed, acceleration in region.QUOTED[:3]:
            assert f"{made.edges[name].at(speed, acceleration):.2f}" in said
        assert said.count("none") == 1
        assert any("no proof can exist" in text and limit in text for text in said)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert "proven up to this yaw rate [rad/s]" in labels
    assert "yaw rate [rad/s]" in labels
    path = plots_design.save(made, tmp_path / "map.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(OutputError, match="cannot write"):
        plots_design.save(made, tmp_path / "missing" / "map.png")


def test_rays_of_equal_yaw_rate_stand_on_certificates(made: region.Map) -> None:
    """Along a ray the yaw rate of its label is proven; a little above it is not, as far as the table goes."""
    edge = made.edges["published"]
    for level in (0.5, 1.0, 2.0):
        r = edge.ratio[edge.yaw_rate >= level].max()
        assert edge.at(4.0, 4.0 * r) >= level
        assert not edge.at(4.0, 4.0 * r * 1.001) >= level


def test_a_proven_decay_is_written_at_the_colours() -> None:
    made = region.map({"ours": OURS}, SPEEDS, ACCELERATIONS, rate=0.5, step=0.2, count=6)
    figure = plots_design.region_map(made)
    assert "proven up to this yaw rate [rad/s], decay 0.5 1/s" in [ax.get_ylabel() for ax in figure.axes]
    assert all(proof.rate == 0.5 for proof in made.edges["ours"].certificates if proof)
    assert made.edges["ours"].limit == region.frozen_limit(OURS, 0.5)
