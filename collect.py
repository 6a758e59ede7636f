import sys, time, pickle, numpy as np
from agents.vector_face import ResectVecEnv
from agents.candidate_policy import read_candidates
def collect(scene, split, mask, n_steps, seed, p_cert=.4, p_plan=.5, rows=64):
    env=ResectVecEnv(rows,scene=scene,split=split,mask=mask); env.seed(seed); obs=env.reset(); rng=np.random.default_rng(seed)
    out=[]
    for _ in range(n_steps//rows):
        legal=obs["action_mask"]; acts=np.zeros(rows,np.int64)
        cands=read_candidates(obs)
        for r in range(rows):
            order=[a for a in env.envs.scene_of(r).certificate.order if legal[r,a]]
            u=rng.random()
            if order and u<p_cert: acts[r]=order[0]
            elif order and u<p_cert+p_plan: acts[r]=order[rng.integers(len(order))]
            else: acts[r]=rng.choice(np.flatnonzero(legal[r]))
        before=obs["globals"][:,4].copy()
        obs,rew,done,infos=env.step(acts)
        after=obs["globals"][:,4].copy(); col=np.zeros(rows,bool); 
        for r in np.flatnonzero(done):
            after[r]=infos[r]["terminal_observation"]["globals"][4]; col[r]=infos[r]["reason"] not in ("separated","budget")
        out.append((cands,acts,before,after,col,done.copy()))
    return out
if __name__=="__main__":
    t=time.process_time()
    d=collect("box-192","train","focus",40000,0); print("train",time.process_time()-t)
    v=collect("box-192","validation","focus",4000,1)
    pickle.dump((d,v),open(sys.argv[1],"wb"))
    for x in (d,v):
        col=np.concatenate([e[4] for e in x]); af=np.concatenate([e[3] for e in x]); print(col.mean(), np.quantile(af,[.05,.25,.5,.75,.95]))
