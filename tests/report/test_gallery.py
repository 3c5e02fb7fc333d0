"""The gallery's command line."""

import pytest

from sboc_e2e.report import gallery


@pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), ([], 2), (["--size"], 2)])
def test_words_that_are_no_folder_make_none(arguments, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        gallery.main(arguments)
    assert stopped.value.code == code
    assert "folder" in "".join(capsys.readouterr())
    assert not list(tmp_path.iterdir())
