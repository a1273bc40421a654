"""Folders of failed runs: an earlier failed run is replaced, a folder of the user never."""

from support import simulation


def test_a_folder_with_other_content_is_never_replaced(tmp_path):
    for number in ("", *range(2, 120)):
        (tmp_path / f"run.failed{number}").mkdir()
    folder = simulation._choose_failure_folder(tmp_path / "run")
    assert folder == tmp_path / "run.failed120"


def test_the_folder_of_an_earlier_failed_run_is_replaced(tmp_path):
    (tmp_path / "run.failed").mkdir()
    (tmp_path / "run.failed2").mkdir()
    (tmp_path / "run.failed2" / "failure.json").write_text("{}")
    assert simulation._choose_failure_folder(tmp_path / "run") == tmp_path / "run.failed2"
