"""Settings: what is written is read back, what is unknown is refused with the nearest names."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import settings_table
from outrider.errors import InputError
from outrider.settings import Detect, Recording, Settings, Timing, dump, load, override


def reread(tmp_path, settings):
    path = tmp_path / "settings.toml"
    path.write_text(dump(settings), encoding="utf-8")
    return load(path)


def test_defaults_survive_a_file(tmp_path):
    assert reread(tmp_path, Settings()) == Settings()


@given(
    scale=st.floats(1e-3, 1e3),
    hits=st.integers(1, 100),
    length=st.none() | st.floats(0.1, 20.0),
    increment=st.none() | st.floats(-1e-2, 1e-2),
    topics=st.lists(st.text(max_size=20), max_size=3),
    gains=st.dictionaries(
        st.text(max_size=9), st.dictionaries(st.text(max_size=9), st.floats(allow_nan=False)), max_size=3
    ),
)
def test_any_settings_survive_a_file(tmp_path, scale, hits, length, increment, topics, gains):
    settings = Settings(
        recording=Recording(scale=scale, truth_topics=tuple(topics)),
        timing=Timing(time_increment_s=increment),
        detect=Detect(min_hits=hits, body_length_m=length),
        observer=msgspec.structs.replace(Settings().observer, gains=gains),
    )
    assert reread(tmp_path, settings) == settings


def test_a_file_with_a_few_keys_leaves_the_rest_at_their_defaults(tmp_path):
    path = tmp_path / "few.toml"
    path.write_text("[detect]\nmin_hits = 7\n")
    assert load(path) == Settings(detect=Detect(min_hits=7))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[detect]\nmin_hist = 3\n", "did you mean detect.min_hits"),
        ("[detekt]\nmin_hits = 3\n", "detekt"),
        ("[detect]\nmin_hits = 'three'\n", r"few\.toml.*int"),
        ("[detect\n", r"few\.toml: not TOML"),
    ],
)
def test_a_wrong_file_is_one_clear_line(tmp_path, text, said):
    path = tmp_path / "few.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        load(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_one_clear_line(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: cannot read settings"):
        load(tmp_path / "none.toml")


def test_override_takes_toml_values_and_bare_words():
    settings = override(
        Settings(),
        [
            "detect.min_hits=5",
            "detect.body_length_m=4.2",
            "recording.scan_topic=/front scan",
            "recording.ego_topic=none",
            'recording.truth_topics=["/a", "/b"]',
            "observer.gains.multi_stage.speed=3.0",
        ],
    )
    assert settings.detect == Detect(min_hits=5, body_length_m=4.2)
    assert settings.recording.scan_topic == "/front scan"
    assert settings.recording.ego_topic == "none"
    assert settings.recording.truth_topics == ("/a", "/b")
    assert settings.observer.gains == {"multi_stage": {"speed": 3.0}}


def test_override_with_none_goes_back_to_the_default():
    settings = Settings(timing=Timing(scan_time_s=0.1))
    assert override(settings, ["timing.scan_time_s=none"]) == Settings()


@pytest.mark.parametrize(
    "text", ["detect", "detect.min_hits", "min_hits=3", "detect.min_hits=a", "detect.min_hits.x=1", "a.b.c=1"]
)
def test_a_wrong_override_is_refused(text):
    with pytest.raises(InputError, match="--set"):
        override(Settings(), [text])


def test_a_mistyped_override_names_the_key_that_was_meant():
    with pytest.raises(InputError, match=r"alert\.danger_s"):
        override(Settings(), ["alert.dangr_s=2"])


def test_settings_cannot_be_changed_in_place():
    with pytest.raises(AttributeError):
        Settings().detect.min_hits = 5  # type: ignore[misc]


def test_every_key_says_what_it_means():
    silent = [f"{name}.{row[0]}" for name, _, rows in settings_table.sections() for row in rows if not row[3]]
    assert silent == []


def test_the_page_of_settings_is_up_to_date():
    text = settings_table.PAGE.read_text()
    assert text == settings_table.page(text), "run: python tests/settings_table.py"
