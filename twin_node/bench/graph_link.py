"""Two machines on one host: network namespaces whose link carries every packet late, loses some, and can be cut.

The packets are those of the kernel's own TCP (a TUN device in each namespace), so what loss and cuts do to
connections is what they do between real hosts: retransmission, back-off and all.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import itertools
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Sequence

from twin_node.bench.errors import BenchError

CLONE_NEWNET = 0x40000000
TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
"""Of linux/sched.h and linux/if_tun.h."""
DEVICE = "link"
PACKET_BYTES = 65536
"""Largest IP packet."""
MTU_BYTES = 1500
"""As on Ethernet: a message of many kilobytes is many packets, each of which can be lost."""


class Machine:
    """A network namespace with one end of a link; what is started in it sees no other network."""

    def __init__(self, address: str) -> None:
        """`address`: IPv4 with prefix length. Raises `BenchError` where this user may not make namespaces."""
        self.address = address.partition("/")[0]
        self._error: OSError | None = None
        thread = threading.Thread(target=self._make, name="namespace")
        thread.start()
        thread.join()
        if self._error is not None:
            raise BenchError(
                f"bench graph: no network namespace with a TUN device can be made ({self._error.strerror}); run it as "
                "root where /dev/net/tun is, or under 'unshare --map-root-user'"
            )
        self._processes: list[subprocess.Popen[str]] = []
        self._configure(["addr", "add", address, "dev", DEVICE])
        self._configure(["link", "set", "dev", DEVICE, "up", "mtu", str(MTU_BYTES)])
        self._configure(["link", "set", "dev", "lo", "up"])

    def start(self, command: Sequence[str]) -> subprocess.Popen[str]:
        """A process on this machine, with pipes to its input and from its output."""
        process = subprocess.Popen(
            self._inside(command), pass_fds=(self._namespace,), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._processes.append(process)
        return process

    def end(self) -> None:
        """Ends its processes by the end of their input; they may still need the link for that."""
        for process in self._processes:
            if process.stdin is not None:
                process.stdin.close()
            process.wait()

    def close(self) -> None:
        """Lets go of the namespace; the link must be closed."""
        os.close(self.device)
        os.close(self._namespace)

    def _make(self) -> None:
        """In a thread of its own: only that moves into the new namespace."""
        libc = ctypes.CDLL(None, use_errno=True)
        try:
            if libc.unshare(CLONE_NEWNET) != 0:
                number = ctypes.get_errno()
                raise OSError(number, os.strerror(number))
            self.device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
            """File descriptor: a packet per read or write."""
            fcntl.ioctl(self.device, TUNSETIFF, struct.pack("16sH22x", DEVICE.encode(), IFF_TUN | IFF_NO_PI))
            self._namespace = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        except OSError as error:  # raised as our own in the thread that asked
            self._error = error

    def _configure(self, arguments: Sequence[str]) -> None:
        command = self._inside(["ip", *arguments])
        try:
            subprocess.run(command, pass_fds=(self._namespace,), check=True, capture_output=True, text=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise BenchError(
                f"bench graph: {' '.join(command)} failed ({error}); install iproute2 and util-linux"
            ) from None

    def _inside(self, command: Sequence[str]) -> list[str]:
        return ["nsenter", f"--net=/proc/self/fd/{self._namespace}", *command]


class Link:
    """Carries packets between two machines, in a thread of its own."""

    def __init__(self, near: Machine, far: Machine, delay_s: float, loss: float) -> None:
        """`delay_s`: each way; `loss`: share of packets that never arrive."""
        self.is_cut = False
        """Whether every packet is lost, those under way too."""
        self._other = {near.device: far.device, far.device: near.device}
        self._delay_s = delay_s
        self._loss = loss
        self._random = random.Random(0)
        self._under_way: list[tuple[float, int, int, bytes]] = []
        self._order = itertools.count()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Carries nothing any more."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopped.is_set():
            wait_s = 0.1 if not self._under_way else max(0.0, self._under_way[0][0] - time.monotonic())
            for device in select.select(list(self._other), [], [], wait_s)[0]:
                self._take(device)
            now = time.monotonic()
            while self._under_way and self._under_way[0][0] <= now:
                _, _, device, packet = heapq.heappop(self._under_way)
                if not self.is_cut:
                    os.write(device, packet)

    def _take(self, device: int) -> None:
        packet = os.read(device, PACKET_BYTES)
        if self._random.random() >= self._loss:
            due = time.monotonic() + self._delay_s
            heapq.heappush(self._under_way, (due, next(self._order), self._other[device], packet))
