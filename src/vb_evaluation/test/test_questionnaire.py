import pytest

from refusals import refused
from vb_evaluation import statistics
from vb_evaluation.report import questionnaire


def write(path, rows, columns=None):
    columns = columns or questionnaire.COLUMNS
    path.write_text(
        "\n".join(",".join(str(cell) for cell in row) for row in [columns, *rows]) + "\n", encoding="utf-8-sig"
    )
    return path


def row(name, nrs, robot_only, helped="yes"):
    """The same pair of answers to all statements."""
    return [name, *[answer for _ in questionnaire.STATEMENTS for answer in (nrs, robot_only)], helped]


def test_fifteen_people_as_in_the_paper(tmp_path):
    # Sect. 5.8.2: 14 of 15 said yes; statement 3 has M = 4.47 and 3.13, which no one set of answers need have had:
    # these sum to the same means
    nrs, alone = [5, 5, 5, 5, 5, 5, 5, 4, 4, 4, 4, 4, 4, 4, 4], [3, 4, 3, 4, 3, 3, 4, 3, 3, 2, 3, 4, 2, 3, 3]
    rows = [row(f"p{number}", a, b, "no" if number == 1 else "yes") for number, (a, b) in enumerate(zip(nrs, alone), 1)]
    found = questionnaire.read(write(tmp_path / "answers.csv", rows))
    assert (found.helped, found.asked) == (14, 15)
    third = found.answers[2]
    assert (round(third.first.mean(), 2), round(third.second.mean(), 2)) == (4.47, 3.13)
    # one of them sees no difference, the other fourteen all rate the network robot system higher
    compared = statistics.compare_paired(third.first, third.second)
    assert compared.test.z < -3.0 and compared.test.p_exact == 2.0**-13 and compared.rank_biserial == 1.0
    assert "demanding" in third.statement and compared.n == 15


def test_answers_not_given_are_left_out(tmp_path):
    found = questionnaire.read(write(tmp_path / "a.csv", [row("a", 5, ""), row("b", 4, 3), row("c", 5, 2, "")]))
    assert found.answers[0].first.tolist() == [4.0, 5.0] and (found.helped, found.asked) == (2, 2)


@pytest.mark.parametrize(
    "rows, columns, words",
    [
        ([row("a", 6, 3)], None, "line 2: s1_nrs: expected a whole number from 1 to 5, got '6'"),
        ([row("a", 3.5, 3)], None, "got '3.5'"),
        ([row("a", 3, 3), row("a", 3, 3)], None, "line 3: participant"),
        ([row("a", 3, 3, "perhaps")], None, "helped: expected yes or no"),
        ([], None, "nobody has answered"),
        ([], ["participant"], "s1_nrs"),
    ],
)
def test_wrong_answers_name_line_or_column(rows, columns, words, tmp_path):
    path = write(tmp_path / "a.csv", rows, columns=columns)
    with refused("bad_questionnaire") as caught:
        questionnaire.read(path)
    assert words in str(caught.value)
    path.unlink()
    with refused("bad_questionnaire"):
        questionnaire.read(path)
