import time, os, sys, warnings
import numpy as np
from . import Case
def fifo(p):
    os.mkfifo(p); open(p).read()
def case(index, rng, room):
    (room.folder/"in.json").write_text("{}")
    out=room.folder/"out"
    todo=[
     ("fine status", None, ["factory","materials","list"]),
     ("plan", None, ["factory","plan",str(room.folder/"in.json"),"--no-probe"]),
     ("usage", None, ["factory","plan","--wrong"]),
     ("sleep", lambda: time.sleep(100), None),
     ("memory", lambda: np.ones(3<<27).sum(), None),
     ("raise", lambda: 1/0, None),
     ("segv", lambda: os.kill(os.getpid(), 11), None),
     ("warn", lambda: warnings.warn("x"), None),
     ("fifo", lambda: fifo(room.folder/"p"), None),
     ("part", lambda: (out.mkdir(), (out/".x.part").write_text("")), None),
     ("outside", lambda: open("abc","w").write("h"), None),
     ("change", lambda: (room.folder/"in.json").write_text("[]"), None),
     ("torch", lambda: __import__("learn.layer").layer.render(*map(__import__("torch").rand,[(1,8,8,3),(1,108),(1,64,128,3)])).shape, None),
     ("fresh", None, ["factory","plan",str(room.folder/"in.json"),"--no-probe"]),
    ]
    label, run, command = todo[index%len(todo)]
    return Case(label=label, run=run, command=command, fresh=label=="fresh")
