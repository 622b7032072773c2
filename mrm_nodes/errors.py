"""The one error that a user's request or machine can cause, and the one warning."""


class MrmError(Exception):
    """The request or the machine is at fault: says what, where, and what to do.

    The command line prints it as one line on stderr and exits with status 2.
    """


class MrmWarning(UserWarning):
    """Something was changed on the user's behalf (a value clamped, normals made) and the work went on."""
