"""The one exception tree, and the exit code each branch ends a command with."""


class OutriderError(Exception):
    """Anything outrider refuses to do; the message says what was got, what was wanted and what to do."""

    exit_code = 1


class InputError(OutriderError):
    """A wrong argument, setting or file."""

    exit_code = 2


class OutputError(OutriderError):
    """A result that could not be written (permissions, disk full); what was written before stays readable."""

    exit_code = 2


class NotCertified(OutriderError):
    """A proof that does not hold, or could not be found; the message says why and what to relax."""

    exit_code = 3
