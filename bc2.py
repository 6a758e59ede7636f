import sys,pickle,os,time
from ft import *
R,H,seed,ep=(int(a) for a in sys.argv[1:5]); hid=int(sys.argv[5]) if len(sys.argv)>5 else 32
f="/tmp/bc192g.pkl"
if not os.path.exists(f): pickle.dump((dataset("box-192","train","focus"),dataset("box-192","validation","focus")),open(f,"wb"))
(S,A),(VS,VA)=pickle.load(open(f,"rb"))
import agents.candidate_policy as cp
env=ResectEnv("box-192","validation","focus")
torch.manual_seed(seed); rng=np.random.default_rng(seed)
pol=cp.CandidatePolicy(env.observation_space,env.action_space,lambda _:3e-3,hidden=hid,n_rounds=R,n_heads=H)
opt=torch.optim.Adam(pol.parameters(),lr=3e-3); t=time.process_time()
vj=join(VS); VT=torch.from_numpy(VA)
for e in range(ep):
    for g in opt.param_groups: g["lr"]=3e-3*(1-e/ep)
    perm=rng.permutation(len(A)); tot=0
    for k in range(0,len(perm)-63,64):
        b=perm[k:k+64]
        _,lp,_=pol.evaluate_actions(join([S[i] for i in b]), torch.from_numpy(A[b]))
        loss=-lp.mean(); opt.zero_grad(); loss.backward(); opt.step(); tot+=float(loss.detach())*64
    if e%4==3:
        with torch.no_grad(): v=-pol.evaluate_actions(vj,VT)[1].mean()
        print(R,H,seed,e,"train %.3f val %.3f"%(tot/len(perm),float(v)),round(time.process_time()-t,1),flush=True)
s=summarise(evaluate(pol,env)); print(s.total_return,s.success,s.reasons)
