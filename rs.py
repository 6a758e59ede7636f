import sys, time, numpy as np, torch, pickle, os
torch.set_num_threads(1)
from agents.candidate_policy import read_candidates
from agents.features import join
from agents.evaluation import evaluate, summarise
from envs.resect import ResectEnv
from envs.vector import ResectVectorEnv
from gymnasium.vector import AutoresetMode
import agents.candidate_policy as cp
N=32
def collect(scene,split,mask,n_orders,rng):
    envs=ResectVectorEnv(N,scene,split,mask,autoreset_mode=AutoresetMode.SAME_STEP); envs.reset(seed=0)
    S=[];A=[];G=[];OK=[]
    for first in range(0,len(envs.scenes),N):
      idx=range(first,min(first+N,len(envs.scenes)))
      for k in range(n_orders):
        for row,i in enumerate(idx): obs,_=envs.reset(options={"index":i,"reset_mask":np.arange(N)==row})
        orders=[list(envs.scene_of(r).certificate.order) for r in range(len(idx))]
        if k: orders=[list(rng.permutation(o)) for o in orders]
        alive=np.ones(len(idx),bool); eps=[([],[],[]) for _ in idx]; ok=np.zeros(len(idx),bool)
        for p in range(max(map(len,orders))):
            chosen=obs["action_mask"].argmax(1); rows=[]
            for r in range(len(idx)):
                while alive[r] and orders[r] and not obs["action_mask"][r,orders[r][0]]: orders[r].pop(0)
                if alive[r] and orders[r]: chosen[r]=orders[r].pop(0); rows.append(r)
            if not rows: break
            seen=read_candidates(obs).split()
            obs,rew,te,tr,info=envs.step(chosen)
            for r in rows:
                eps[r][0].append(seen[r]); eps[r][1].append(chosen[r]); eps[r][2].append(rew[r])
                if te[r] or tr[r]: alive[r]=False; ok[r]=rew[r]>.5
        for r,(s,a,w) in enumerate(eps):
            S+=s; A+=a; G+=list(np.cumsum(w[::-1])[::-1]); OK+=[ok[r]]*len(s)
    return S,np.array(A),np.array(G,np.float32),np.array(OK)
if __name__=="__main__":
    n=int(sys.argv[1]); ep=int(sys.argv[2]); seed=int(sys.argv[3]); rng=np.random.default_rng(seed); torch.manual_seed(seed)
    t=time.process_time(); S,A,G,OK=collect("box-192","train","focus",n,rng); print("collected",len(A),"ok",OK.mean(),round(time.process_time()-t,1),flush=True)
    env=ResectEnv("box-192","validation","focus")
    pol=cp.CandidatePolicy(env.observation_space,env.action_space,lambda _:3e-3,hidden=32)
    VS,VA,VG,VOK=collect("box-192","validation","focus",4,rng)
    opt=torch.optim.Adam(pol.parameters(),lr=3e-3); t=time.process_time(); B=64; steps=ep*(len(A)//B); it=0
    tG=torch.from_numpy(G); w=torch.from_numpy(OK.astype(np.float32)); tA=torch.from_numpy(A)
    for e in range(ep):
        perm=rng.permutation(len(A)); L=[]
        for k in range(0,len(perm)-B+1,B):
            for g in opt.param_groups: g["lr"]=3e-3*(1-it/steps)
            it+=1; b=perm[k:k+B]; v,lp,_=pol.evaluate_actions(join([S[i] for i in b]),tA[b])
            l1=-(lp*w[b]).sum()/w[b].sum(); l2=((v.flatten()-tG[b])**2).mean(); (l1+.5*l2).backward(); opt.step(); opt.zero_grad(); L.append((float(l1.detach()),float(l2.detach())))
        with torch.no_grad():
            o=[pol.evaluate_actions(join(VS[k:k+256]),torch.from_numpy(VA[k:k+256])) for k in range(0,len(VS),256)]
            vv=torch.cat([x[0].flatten() for x in o]).numpy(); lp=torch.cat([x[1] for x in o]).numpy()
        s=summarise(evaluate(pol,env)); print(e,round(time.process_time()-t,1),"train",np.mean(L,0),"val nll",-lp[VOK].mean(),"ev",1-((vv-VG)**2).mean()/VG.var(),"%.3f %.3f"%(s.total_return.mean,s.success.mean),s.reasons,flush=True)
    torch.save(pol.state_dict(),f"/tmp/rs{seed}.pt")
