import cProfile,pstats,tempfile,time,os,sys
from pathlib import Path
from fuzz.batches import preload
from fuzz.seeds import all_seeds
from fuzz.cases import make_case
from fuzz.running import Runner
models=all_seeds(Path("build/fuzz-corpus").resolve())
preload()
r=Runner(Path(tempfile.mkdtemp(dir="/dev/shm")))
t=time.time();c0=time.process_time()
slow=[]
def go():
    for s in range(1,800):
        t0=time.time(); c=make_case(s,models); t1=time.time(); o,f=r.run(c); t2=time.time()
        slow.append((t2-t1,t1-t0,s,c.arguments,o.code))
p=cProfile.Profile()
if len(sys.argv)>1: p.runcall(go); pstats.Stats(p).sort_stats("tottime").print_stats(18)
else: go()
print(time.time()-t, time.process_time()-c0); print(sum(s[1] for s in slow))
slow.sort(reverse=True)
for s in slow[:25]: print("%.3f %.3f"%s[:2],s[2:])
