"""Runs a command without prctl(PR_GET_AUXV), as before Linux 6.4: `without_auxv.py COMMAND...`.

Valgrind hides the vDSO from the program that it runs, but not from that call, by which rustix finds it; reading
where it was, the program then dies. Refused, rustix reads /proc/self/auxv, which valgrind answers.
"""

import ctypes
import os
import struct
import sys

PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
PR_GET_AUXV = 0x41555856
PRCTL = {"x86_64": 157, "aarch64": 167}
LOAD, JUMP_IF_EQUAL, RETURN = 0x20, 0x15, 0x06
ALLOW, ERROR = 0x7FFF0000, 0x00050000
EINVAL = 22

rules = [
    (LOAD, 0, 0, 0),  # the call's number
    (JUMP_IF_EQUAL, 0, 3, PRCTL[os.uname().machine]),
    (LOAD, 0, 0, 16),  # its first argument's lower half
    (JUMP_IF_EQUAL, 0, 1, PR_GET_AUXV),
    (RETURN, 0, 0, ERROR | EINVAL),
    (RETURN, 0, 0, ALLOW),
]
program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *rule) for rule in rules))
header = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", len(rules), ctypes.addressof(program)))
libc = ctypes.CDLL(None, use_errno=True)
if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, header, 0, 0):
    sys.exit(f"seccomp: {os.strerror(ctypes.get_errno())}")
os.execvp(sys.argv[1], sys.argv[1:])
