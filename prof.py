import sys,pickle,time
from ft import *
import agents.candidate_policy as cp
(S,A),_=pickle.load(open("/tmp/bc192g.pkl","rb"))
env=ResectEnv("box-192","validation","focus")
def go(R,H,hid=32):
    pol=cp.CandidatePolicy(env.observation_space,env.action_space,lambda _:3e-3,hidden=hid,n_rounds=R,n_heads=H)
    rng=np.random.default_rng(0); T={}
    def tick(n,t): T.setdefault(n,[]).append(time.process_time()-t); return time.process_time()
    for k in range(12):
        b=rng.permutation(len(A))[:64]
        t=time.process_time(); j=join([S[i] for i in b]); t=tick("join",t)
        p=cp.prepared(j); t=tick("prepared",t)
        _,lp,_=pol.evaluate_actions(j, torch.from_numpy(A[b])); t=tick("fwd",t)
        (-lp.mean()).backward(); t=tick("bwd",t)
    print(R,H,len(j.action),len(j.tetrahedra),{k:round(1e3*float(np.median(v)),1) for k,v in T.items()})
    from torch.profiler import profile, ProfilerActivity
    if R and H:
        with profile(activities=[ProfilerActivity.CPU]) as prof:
            _,lp,_=pol.evaluate_actions(j, torch.from_numpy(A[b])); (-lp.mean()).backward()
        print(prof.key_averages().table(sort_by="self_cpu_time_total",row_limit=16,max_name_column_width=40).replace("  "," "))
go(3,2)
