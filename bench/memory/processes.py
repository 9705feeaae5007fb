"""Runs a program and watches what memory it and its children take."""

import os
import pathlib
import resource
import subprocess
import threading
import time

FIELDS = {'Pss:': 'pss', 'Private_Clean:': 'private', 'Private_Dirty:': 'private', 'Shared_Clean:': 'shared',
          'Shared_Dirty:': 'shared', 'Rss:': 'rss', 'Swap:': 'swap'}


def memory_of(pid):
    """Bytes of one process, or None when it is gone."""
    found = dict.fromkeys(set(FIELDS.values()), 0)
    try:
        for line in pathlib.Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()[1:]:
            words = line.split()
            if words[0] in FIELDS:
                found[FIELDS[words[0]]] += int(words[1]) * 1024
    except (OSError, ValueError, IndexError):
        return None
    return found


def family(pid):
    """The process and all that it started, now."""
    found, at = [pid], 0
    while at < len(found):
        for task in pathlib.Path(f'/proc/{found[at]}/task').glob('*/children'):
            try:
                found += [int(p) for p in task.read_text().split()]
            except OSError:
                pass
        at += 1
    return found


def name_of(pid):
    try:
        return pathlib.Path(f'/proc/{pid}/comm').read_text().strip()
    except OSError:
        return ''


class Watched:
    """One run. samples: [(seconds, {process name: {'pss': bytes, ...}})]. PSS counts shared pages once for all
    processes together, pages of files that are mapped included."""

    def __init__(self, command, folder, interval=0.05, limit=None, environment=None):
        self.samples = []
        group = MemoryGroup(limit) if limit else None
        self.limited = bool(group and group.path)
        started, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                   env={**os.environ, **(environment or {})},
                                   preexec_fn=group.enter if self.limited else None)
        done = threading.Event()

        def watch():
            while not done.wait(interval):
                row = {}
                for pid in family(process.pid):
                    memory = memory_of(pid)
                    name = name_of(pid)
                    if not name or memory is None or memory['rss'] == 0:
                        continue  # it ends at this moment
                    mine = row.setdefault(name, dict.fromkeys(memory, 0))
                    for key, value in memory.items():
                        mine[key] += value
                if row:
                    self.samples.append((time.monotonic() - started, row))

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        self.out, self.err = process.communicate()
        self.seconds = time.monotonic() - started
        self.status = process.returncode
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.processor = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime  # seconds
        done.set()
        watcher.join()
        if group:
            group.close()

    def total(self, field='pss'):
        return [(t, sum(p[field] for p in row.values())) for t, row in self.samples]

    def peak(self, field='pss'):
        return max((value for _, value in self.total(field)), default=0)


class MemoryGroup:
    """A memory control group of version 1 with a hard limit, where we may make one; else path is None."""

    def __init__(self, limit):
        self.path = None
        path = pathlib.Path(f'/sys/fs/cgroup/memory/frankenrender-bench-{os.getpid()}')
        try:
            path.mkdir()
            (path / 'memory.limit_in_bytes').write_text(str(int(limit)))
            self.path = path
        except OSError:
            pass

    def enter(self):
        (self.path / 'cgroup.procs').write_text(str(os.getpid()))

    def close(self):
        if self.path:
            try:
                self.path.rmdir()
            except OSError:
                pass
