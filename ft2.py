import sys, time, numpy as np, torch, pickle, os
torch.set_num_threads(1)
from agents.demonstrations import demonstrate
from agents.features import join
from agents.training import make_model
from agents.training_config import TrainingConfig
from agents.training_view import make_environments
from agents.evaluation import evaluate, summarise
from envs.resect import ResectEnv
from gmapspring.config import load_config
from gmapspring.paths import configs_folder
from stable_baselines3.common.logger import Logger
def run(seed, bc=8, secs=250., lr=5e-4, name="box-192", every=40, bclr=3e-3, init=None, save=None, **change):
    config=load_config(configs_folder()/"train"/f"{name}.yaml",TrainingConfig).replaced(seed,None)
    ppo=config.ppo.model_copy(update={"learning_rate":lr}|change); config=config.model_copy(update={"ppo":ppo})
    torch.manual_seed(seed); rng=np.random.default_rng(seed)
    envs=make_environments(config); model=make_model(config,envs); pol=model.policy
    val=ResectEnv(config.scene,"validation",config.mask)
    if init: pol.load_state_dict(torch.load(init))
    elif bc:
        t=time.process_time(); f=f"/tmp/demo-{config.scene}-{config.mask}.pkl"
        if not os.path.exists(f): pickle.dump(demonstrate(config.scene,"train",config.mask),open(f,"wb"))
        D=pickle.load(open(f,"rb")); S,A=D.states,D.actions; print(len(A),"states",round(time.process_time()-t,1),flush=True)
        opt=torch.optim.Adam(pol.parameters(),lr=bclr); t=time.process_time()
        for e in range(bc):
            for g in opt.param_groups: g["lr"]=bclr*(1-e/bc)
            perm=rng.permutation(len(A)); tot=0
            for k in range(0,len(perm)-63,64):
                b=perm[k:k+64]
                _,lp,_=pol.evaluate_actions(join([S[i] for i in b]), torch.from_numpy(A[b]))
                loss=-lp.mean(); opt.zero_grad(); loss.backward(); opt.step(); tot+=float(loss.detach())*64
        s=summarise(evaluate(pol,val)); print(seed,"bc",round(tot/len(perm),3),round(time.process_time()-t,1),s.total_return,s.success,flush=True)
        if save: torch.save(pol.state_dict(),save+"-bc")
    model.set_logger(Logger(None,[])); t=time.process_time(); nxt=every; size=ppo.n_envs*ppo.n_steps
    while (now:=time.process_time()-t)<secs:
        model.learning_rate=lr*0.5**(model.num_timesteps/ppo.learning_rate_half_life); model._setup_lr_schedule()
        model.learn(size,log_interval=2**62,reset_num_timesteps=False,use_masking=False)
        if now>nxt:
            nxt+=every; ret=np.mean([e["r"] for e in model.ep_info_buffer]); suc=np.mean(model.ep_success_buffer)
            t0=time.process_time(); s=summarise(evaluate(pol,val)); t+=time.process_time()-t0
            L=model.logger.name_to_value
            print(seed,round(now),model.num_timesteps,"train %.2f %.2f"%(ret,suc),"val %.3f %.3f"%(s.total_return.mean,s.success.mean),s.reasons,"ent %.2f ev %.2f kl %.4f clip %.3f"%(-L.get("train/entropy_loss",0),L.get("train/explained_variance",0),L.get("train/approx_kl",0),L.get("train/clip_fraction",0)),flush=True)
    if save: torch.save(pol.state_dict(),save)
if __name__=="__main__":
    run(int(sys.argv[1]),**eval("dict("+",".join(sys.argv[2:])+")"))
