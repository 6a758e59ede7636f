"""trial: BC on certificates with the present network; then how it plays."""
import sys, time, numpy as np, torch
torch.set_num_threads(1)
from agents.training import make_model
from agents.training_config import TrainingConfig
from agents.training_view import make_environments
from agents.candidate_policy import read_candidates, OBSERVATION_KEYS
from agents.features import join
from agents.evaluation import evaluate, summarise
from envs.resect import ResectEnv
from gmapspring.config import load_config
from gmapspring.paths import configs_folder
def dataset(scene, split, mask, n=None):
    env=ResectEnv(scene, split, mask); states=[]; actions=[]
    for i in range(len(env.scenes) if n is None else n):
        obs,_=env.reset(options={"index":i})
        for a in env.scene.certificate.order:
            c=read_candidates({k:obs[k][None] for k in OBSERVATION_KEYS})
            states.append(c); actions.append(a)
            obs,*_=env.step(a)
    return states, np.array(actions)
if __name__=="__main__":
    t=time.process_time()
    config=load_config(configs_folder()/"train"/"box-192.yaml",TrainingConfig)
    S,A=dataset("box-192","train","focus"); print("data",len(A),time.process_time()-t, np.mean([len(s.action) for s in S]),flush=True)
    envs=make_environments(config); model=make_model(config,envs); pol=model.policy
    val=ResectEnv("box-192","validation","focus")
    opt=torch.optim.Adam(pol.parameters(),lr=3e-3)
    rng=np.random.default_rng(0); epochs=int(sys.argv[1])
    t=time.process_time()
    for e in range(epochs):
        for g in opt.param_groups: g["lr"]=3e-3*(1-e/epochs)
        perm=rng.permutation(len(A)); tot=0
        for k in range(0,len(perm)-127,128):
            b=perm[k:k+128]
            _,lp,ent=pol.evaluate_actions(join([S[i] for i in b]), torch.from_numpy(A[b]))
            loss=-lp.mean(); opt.zero_grad(); loss.backward(); opt.step(); tot+=float(loss.detach())*128
        if e%10==9: 
            s=summarise(evaluate(pol,val)); print(e,tot/len(perm),round(time.process_time()-t,1),s.total_return,s.success,s.reasons,flush=True)
