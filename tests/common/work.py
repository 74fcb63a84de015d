"""Work for other processes, in a module that imports little: each process imports it."""

import os
import signal


def squared(number):
    """Return a dictionary with the square; a negative number is an error."""
    if number < 0:
        raise ValueError(f"{number} is negative\nand more")
    return {"square": number * number}


def surroundings(_number):
    """Return the process, its threads for BLAS and its handler of Ctrl-C."""
    return os.getpid(), os.environ["OMP_NUM_THREADS"], signal.getsignal(signal.SIGINT)


def killed(number):
    """Return the number; 1 kills the process."""
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def noted(folder, number):
    """Return the number after a file of its name is written."""
    (folder / str(number)).touch()
    return number
