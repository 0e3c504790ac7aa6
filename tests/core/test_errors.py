"""The one error that a user can cause."""

import pickle

from gpf.core.errors import UserError


def test_it_says_where_what_and_what_to_do():
    assert str(UserError("a.txt", "is empty", "Fill it.")) == "a.txt: is empty. Fill it."


def test_it_travels_between_processes():
    """Workers of a cluster have users, too."""
    error = pickle.loads(pickle.dumps(UserError("a.txt", "is empty", "Fill it.")))
    assert (error.where, error.what, error.todo) == ("a.txt", "is empty", "Fill it.")
    assert str(error) == "a.txt: is empty. Fill it."
