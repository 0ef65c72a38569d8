"""The papers' results beside ours: numbers near those known, verdicts that can fail, a page that is made."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

from outrider import cli
from outrider.errors import InputError
from outrider.models import bicycle
from outrider.observers import high_gain as shipped_high_gain
from outrider.observers import multi_stage as shipped_multi_stage
from outrider.reproduce import (
    _gain_claims,
    cases,
    convergence,
    gains,
    html,
    noise,
    page,
    plant,
    proofs,
    published,
)
from outrider.reproduce.section import Claim, Section, Table, verdict

pytestmark = pytest.mark.once

# RMSE with a yaw 0.36 rad off, 5 s, 1 kHz, computed independently: (case, high-gain and multi-stage, column).
KNOWN = np.array(
    [
        [[0.01, 0.05, 0.36, 0.05], [0.02, 0.05, 0.43, 0.05]],
        [[0.01, 0.08, 0.37, 0.05], [0.06, 0.78, 0.89, 0.06]],
        [[np.nan] * 4, [0.04, 0.38, 0.63, 0.04]],
    ]
)


@pytest.fixture(scope="module")
def plain():
    """RMSE (case, observer, column) of the plain start."""
    return cases.run(cases.PLAIN).errors(cases.PLAIN)


def test_errors_of_the_simulations_are_the_known_ones(plain):
    """Within 0.015; in case 2, where steering passes its range, which is held here, 15 % more."""
    known = np.isfinite(KNOWN)
    tolerance = np.full(KNOWN.shape, 0.015)
    tolerance[1, 1] += 0.15 * KNOWN[1, 1]
    assert (np.abs(plain[:, 1:] - KNOWN)[known] < tolerance[known]).all(), plain.round(3)


def test_observers_rank_as_in_print(plain):
    """Wherever the printed errors of high-gain and multi-stage observer differ by more than two digits."""
    printed = cases.PRINTED[:, 2] - cases.PRINTED[:, 1]
    ours = plain[:, 2] - plain[:, 1]
    clear = np.abs(printed) > 0.025
    assert clear.sum() >= 5
    assert (np.sign(ours) == np.sign(printed))[clear].all()
    assert (plain[:, 1, 0] <= plain[:, [0, 2], 0].min(axis=1)).all()


def test_the_start_that_is_found_fits_better_than_one_beside_it():
    start, score = cases.search((0.28, 0.36), (2.5, 5.0))
    _, worse = cases.search((0.2,), (2.5,))
    assert score < worse
    assert start.given
    assert start in [cases.Start(h, True, t) for h in (0.28, 0.36) for t in (2.5, 5.0)]


# ------------------------------------------------------------------ equations


def states(n=20, seed=0):
    """Random speeds, angles and positions (8, n)."""
    draw = np.random.default_rng(seed)
    low = np.array([-1.0, 1.0, -3.0, -1.0, -3.0, -0.3, -5.0, -5.0])
    return draw.uniform(low[:, None], np.array([1.0, 20.0, 3.0, 1.0, 3.0, 0.3, 5.0, 5.0])[:, None], (8, n))


def test_published_multi_stage_is_the_shipped_one_without_its_additions():
    s, y = states(), published.Seen(*states(seed=1)[[0, 4, 6, 7]])
    ours = np.array(published.multi_stage(published.MultiStage(*s), y, published.MultiStageGains()))
    o = shipped_multi_stage
    for i, column in enumerate(s.T):
        at = int(np.argmin(np.abs(np.array(o.NOMINAL) - column[1])))
        c = o.Coefficients(4.61, 12.24, 9.83, 4.16, o.L_PSI[at], o.L_BETA[at], 0.0, 20.0, 2.0)
        seen = o.Output(y.S[i], y.alpha[i], 0.0, y.x[i], y.y[i])
        assert np.allclose(o.rhs(o.State(*column), seen, c), ours[:, i])


def test_published_high_gain_has_the_shipped_model():
    z = states()[[0, 1, 2, 3, 1, 5]]
    z[4] = states(seed=2)[1]
    free = published.HighGainGains(L=(0.0, 0.0, 0.0), c_max=1.9, floor=2.0)
    still = published.Seen(*np.zeros((4, z.shape[1])))
    ours = np.array(published.high_gain(published.HighGain(*z), still, free))
    o = shipped_high_gain
    for i, column in enumerate(z.T):
        s = o.State(*column, 0.0, 0.0)
        assert np.allclose(o.rhs(s, o.Free(), o.PUBLISHED)[:6], ours[:, i])


@pytest.mark.parametrize("observer", published.OBSERVERS, ids=lambda o: o.name)
def test_what_starts_right_stays_right(observer):
    truth = plant.drive(plant.Drive(10.0, psi=np.array([0.0, 2.0])), 1.0, 2e-3)
    o = np.zeros(2)
    start = observer.start(o, o, o + 10.0, truth.psi[0])
    e = published.simulate(observer, start, plant.measured(truth.x, truth.y), 2e-3)
    assert plant.rmse(truth, e).max() < 1e-9


def test_a_run_that_leaves_all_bounds_is_held_and_counted():
    wild = published.HIGH_GAIN._replace(gains=published.HighGainGains(L=(-20.0, 0.0, 0.0)))
    truth = plant.drive(plant.Drive(np.array([10.0, 10.0])), 1.0, 1e-2)
    o = np.array([0.0, 1.0])
    e = published.simulate(
        wild, wild.start(o, 0.0 * o, 10.0 + 0.0 * o, 0.0 * o), plant.measured(truth.x, truth.y), 1e-2
    )
    assert e.lost.tolist() == [False, True]
    assert np.isfinite(e.x).all()
    assert np.isinf(plant.rmse(truth, e)[-1, 1]).all()


def test_jacobian_of_the_filter_is_that_of_the_motion():
    s = bicycle.State(*(v[:1] for v in states()[[6, 7, 1, 2, 4, 5]]))
    dt, h = 1e-3, 1e-6
    F = convergence.transition(s, dt)[0]
    for i in range(6):
        moved = [bicycle.arc(s._replace(**{s._fields[i]: s[i] + d}), dt) for d in (h, -h)]
        slope = (np.array(moved[0]) - np.array(moved[1]))[:, 0] / (2.0 * h)
        assert np.allclose(F[:, i], slope, atol=1e-4)


def test_a_standing_car_drives_by_noise_alone():
    """The figures of docs/errata.md, E9."""
    assert noise.parked() == pytest.approx([0.35, 0.88, 1.77], rel=0.05)


# ------------------------------------------------------------------ proofs


def test_proofs_are_checked_and_not_believed():
    assert all(gains.orientation_slack(i) > 0.0 for i in range(len(proofs.TABLE_I)))
    for region in proofs.REGIONS:
        assert gains.high_gain_proof(region).proven()
    first = proofs.REGIONS[0]
    assert not gains.high_gain_proof(first._replace(rate=3.0)).proven()
    assert not gains.high_gain_proof(first._replace(gain=(60.0, 300.0, 20000.0))).proven()
    assert gains.speed_bound().margin("continuous") > 0.0


def test_a_false_proof_proves_nothing():
    first = proofs.TABLE_I[0]
    assert gains.orientation_slack(0, first._replace(mu=1.0)) < 0.0
    assert gains.orientation_slack(0, first._replace(sector=0.0)) < 0.0
    assert gains.orientation_slack(0, proofs.TABLE_I[-1]) < 0.0


def test_claims_about_gains_have_the_verdicts_of_the_errata():
    found = {c.source: c.verdict for c in _gain_claims.claims()}
    assert found["[HG 87]"] == "does not hold"
    assert found["[HG 66, 92]"] == "does not hold"
    assert found["[HG 77, 88]"] == "holds in part"
    assert found["[MS 24-26]"] == "does not hold"
    assert found["[MS 58]"] == "does not hold"
    assert found["[MS] IV.B, Theorem 2, Table I"] == "holds"


# ------------------------------------------------------------------ verdicts


def test_verdict_has_three_outcomes():
    assert verdict(True) == "holds"
    assert verdict(False, True) == "holds in part"
    assert verdict(False) == "does not hold"


def test_printed_errors_bear_the_claims_about_them_and_reversed_ones_do_not():
    said = [c.verdict for c in cases._claims(cases.PRINTED, cases.PRINTED)]
    assert said[:3] == ["holds", "holds", "holds"]
    reverse = cases.PRINTED[:, ::-1] + np.array([0.0, 0.1, 0.2])[:, None]
    worse = [c.verdict for c in cases._claims(reverse, reverse)]
    assert "holds" not in worse[:4]
    assert "does not hold" in worse


# ------------------------------------------------------------------ page


def test_parts_are_chosen_by_name():
    assert page.chosen(None) == page.PARTS
    assert page.chosen("noise, gains") == ("gains", "noise")
    with pytest.raises(InputError, match="did you mean gains"):
        page.chosen("gain")
    with pytest.raises(InputError, match="want one of model"):
        page.chosen("")


def reproduce(folder, *tokens):
    return cli.run(["reproduce", "-o", str(folder), "--only", "gains", *tokens])


def test_a_second_run_writes_the_same(tmp_path, capsys):
    assert reproduce(tmp_path / "one") == 0
    assert reproduce(tmp_path / "two", "--json") == 0
    out = capsys.readouterr().out
    assert json.loads(out[out.index("{") :])["sections"][0]["name"] == "gains"
    for name in page.FILES:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    text = (tmp_path / "one" / "reproduce.md").read_text()
    assert "| 20 | 11.44, 0.92 |" in text
    assert "| [HG 87] |" in text
    assert {path.name for path in (tmp_path / "one").iterdir()} == set(page.FILES)


@pytest.mark.parametrize(
    ("tokens", "words"),
    [
        (("--only", "gain"), "did you mean gains"),
        (("--only", "gains,,"), "want one of"),
        ((), "not empty"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, capsys, tokens, words):
    (tmp_path / "something").write_text("")
    assert cli.run(["reproduce", "-o", str(tmp_path), *tokens]) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert words in err


def test_pictures_are_drawn_and_put_into_the_page(tmp_path):
    made = convergence.section(headings=(0, 120))
    paths = page.save([made], tmp_path)
    assert [p.name for p in paths] == [*page.FILES, "far-start.png"]
    assert (tmp_path / "far-start.png").stat().st_size > 10_000
    tags = []
    parser = HTMLParser()
    parser.handle_starttag = lambda tag, attributes: tags.append(tag)
    parser.feed((tmp_path / "reproduce.html").read_text())
    assert (tags.count("img"), tags.count("table"), tags.count("script")) == (1, 2, 0)


def test_text_is_escaped_in_the_page(tmp_path):
    made = Section(
        "x",
        "a < b",
        "One `a<b`.\n\n- *first*\n- second | third",
        (Table("t", ("h",), (("p|q <",),)),),
        claims=(Claim("[MS]", "text", "holds", "1"),),
    )
    found = html.document("T", [made], tmp_path)
    assert "<code>a&lt;b</code>" in found
    assert "<ul><li><em>first</em></li><li>second | third</li></ul>" in found
    assert "| p&#124;q < |" in page.markdown([made])
    assert "1 hold, 0 hold in part, 0 do not hold" in page.markdown([made])
