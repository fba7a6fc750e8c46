"""Every filter finds what is rare, or not there at all, by an index, in both databases."""

import re
from datetime import timedelta

import pytest
from sqlalchemy import select, text

from anisoscope.history import statements
from anisoscope.history.filters import Filters
from anisoscope.history.schema import inspections

FILTERS = {
    "product": Filters(product="none"),
    "recipe": Filters(recipe="0123456789ab"),
    "cavity": Filters(cavity="none", limit=50),
    "station": Filters(station="none", limit=50),
    "operator": Filters(operator="none"),
    "lot": Filters(lot="none"),
    "serial": Filters(serial="none"),
    "verdict": Filters(verdict="INVALID", limit=50),
}


def plan_of(connection, filters, explain):
    statement = select(inspections.c.id).where(*statements.conditions(connection, filters))
    compiled = statement.compile(connection, compile_kwargs={"literal_binds": True})
    return "\n".join(
        str(tuple(line))
        for line in connection.execute(text(f"{explain} {str(compiled).replace(':', chr(92) + ':')}"))
    )


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_is_answered_by_its_index(history, new_row, name):
    history.append_all([new_row(number) for number in range(50)])
    sqlite = history._database.is_sqlite
    with history._database.reading() as connection:
        if not sqlite:  # so few rows are read sooner than their index
            connection.execute(text("SET LOCAL enable_seqscan = off"))
            connection.execute(text("SET LOCAL enable_bitmapscan = off"))
        plan = plan_of(connection, FILTERS[name], "EXPLAIN QUERY PLAN" if sqlite else "EXPLAIN")
    assert f"inspections_by_{name}" in plan
    assert not re.search("SCAN inspections|Seq Scan on inspections", plan)


def test_digits_of_a_recipe_name_all_that_begin_with_them(history, new_row):
    recipes = ["0123456789ab", "01234fffffff", "0124aaaaaaaa", "ffffffffffff", "0123000000aa"]
    history.append_all(
        [new_row(number, recipe=f"plate {digits}", product="plate") for number, digits in enumerate(recipes)]
    )
    for digits in ("0123", "01234", "0124", "ffff", "0000", "0123456789abcdef"):
        expected = {one for one in recipes if one.startswith(digits[:12])}
        found = history.rows(Filters(recipe=digits))
        assert {row.recipe.split()[1] for row in found} == expected
        assert history.count(Filters(recipe=f"plate {digits}")) == len(expected)


def test_the_latest_of_a_common_product_come_from_the_end_of_its_index(history, new_row):
    rows = history.append_all([new_row(number) for number in range(200)])
    found = history.rows(
        Filters(product=rows[0].product, limit=3, until=rows[150].created_at + timedelta(seconds=1))
    )
    assert [row.id for row in found] == [149, 150, 151]
