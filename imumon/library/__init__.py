"""imumon as a library: live samples of a port, recordings as tables, stages of one's own.

Everything here is what the command line is made of; the names that `import imumon` offers stay.
"""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

from pydantic import ConfigDict, ValidationError, validate_call

from imumon.config import wrong_arguments
from imumon.errors import bad_config

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def checked(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Let a function raise BAD_CONFIG, naming each argument that is not of the type that it states.

    Arguments that are missing, or unknown, are a TypeError, as in any function.
    """
    names, strict = signature(function), ConfigDict(strict=True, arbitrary_types_allowed=True)
    call: Callable[..., Result] = validate_call(config=strict)(function)

    @wraps(function)
    def checked_call(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        given = names.bind(*arguments, **named).arguments  # pydantic numbers those without a name
        try:
            return call(**given)
        except ValidationError as error:
            raise bad_config(wrong_arguments(error)) from error

    return checked_call
