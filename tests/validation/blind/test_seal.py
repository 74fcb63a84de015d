"""Seals of the blind benchmark: no label changes unnoticed, and labels are never next to the data."""

import json

import pytest

from validation.blind import make, seal

LABELS = seal.Labels("5a" * 32, 11, {"case-a": {"kind": "none", "causes": []}, "case-b": {"kind": "two", "causes": []}})


@pytest.fixture
def sealed(tmp_path):
    data, file = tmp_path / "data", tmp_path / "sealed" / "labels.json"
    seal.write_labels(LABELS, file, data)
    return data, file


def test_labels_read_back_match_their_commitment(sealed):
    data, file = sealed
    assert seal.read_labels(file) == LABELS
    seal.check_labels(LABELS, data)
    assert [path.name for path in data.iterdir()] == [seal.COMMITMENT]
    assert file.stat().st_mode & 0o077 == 0  # private


def test_a_commitment_reveals_nothing_without_the_salt():
    own = seal.commitment(LABELS)
    other = seal.commitment(seal.Labels("6b" * 32, LABELS.seed, LABELS.cases))
    assert own["all"] != other["all"]
    assert all(own["cases"][case] != other["cases"][case] for case in LABELS.cases)
    same = seal.Labels(LABELS.salt, 1, dict.fromkeys(LABELS.cases, LABELS.cases["case-a"]))
    assert len(set(seal.commitment(same)["cases"].values())) == 2  # equal labels do not show as equal


def test_a_commitment_is_sha_256_of_salt_and_canonical_json():
    import hashlib

    text = (
        LABELS.salt + '{"cases":{"case-a":{"causes":[],"kind":"none"},"case-b":{"causes":[],"kind":"two"}},"seed":11}'
    )
    assert seal.commitment(LABELS)["all"] == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d["cases"]["case-b"].update(kind="none"), "case-b"),
        (lambda d: d["cases"].pop("case-a"), "case-a"),
        (lambda d: d.update(seed=12), "the seed or the salt"),
    ],
)
def test_changed_labels_are_rejected_by_name(sealed, change, expected):
    data, file = sealed
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))
    with pytest.raises(seal.SealError, match=expected):
        seal.check_labels(seal.read_labels(file), data)


def test_a_changed_frozen_file_is_rejected(tmp_path):
    file = tmp_path / "answers.json"
    file.write_text("{}")
    with pytest.raises(seal.SealError, match="not frozen"):
        seal.check_frozen(file)
    digest = seal.freeze(file)
    assert seal.check_frozen(file) == digest
    file.write_text("{} ")
    with pytest.raises(seal.SealError, match="has changed since it was frozen"):
        seal.check_frozen(file)


def test_preparing_seals_first_and_continues_with_the_same_cases(tmp_path):
    data, file = tmp_path / "data", tmp_path / "labels.json"
    cases = make.prepare(data, file, None, 10)
    assert [path.name for path in data.iterdir()] == [seal.COMMITMENT]
    assert make.prepare(data, file, None, 10) == cases
    with pytest.raises(seal.SealError, match="10 other cases"):
        make.prepare(data, file, None, 11)
    with pytest.raises(seal.SealError, match="10 other cases"):
        make.prepare(data, file, None, 10, seed=1)
    with pytest.raises(seal.SealError, match="is not empty"):
        make.prepare(data, tmp_path / "other.json", None, 10)
    with pytest.raises(seal.SealError, match="outside"):
        make.prepare(tmp_path / "new", tmp_path / "l.json", tmp_path / "new" / "fresh", 10)
