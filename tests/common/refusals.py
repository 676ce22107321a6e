"""What is refused: in one line, which names what is wrong."""

import re
from collections.abc import Callable

import pytest

from surefoot.sim.common.errors import SurefootError


def refusal(
    function: Callable, *arguments, error: type[BaseException] = SurefootError, **options
) -> str:
    """The message, of one line, with which this call is refused."""
    with pytest.raises(error) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def refused(words: str, function: Callable, *arguments, **options) -> str:
    """The message of a call that is refused, in which this regular expression is found."""
    message = refusal(function, *arguments, **options)
    assert re.search(words, message), message
    return message
