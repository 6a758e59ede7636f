import sys, time, numpy as np, torch
torch.set_num_threads(1)
from bc import *
from stable_baselines3.common.logger import Logger
def run(seed, bc_epochs=10, secs=250., lr=5e-4, ent=.002, config_name="box-192", n_epochs=1, log=True, S=None, A=None, change={}):
    config=load_config(configs_folder()/"train"/f"{config_name}.yaml",TrainingConfig).replaced(seed,None)
    ppo=config.ppo.model_copy(update={"entropy":ent,"learning_rate":lr,"n_epochs":n_epochs}|change); config=config.model_copy(update={"ppo":ppo})
    torch.manual_seed(seed); rng=np.random.default_rng(seed)
    envs=make_environments(config); model=make_model(config,envs); pol=model.policy
    val=ResectEnv(config.scene,"validation",config.mask)
    opt=torch.optim.Adam(pol.parameters(),lr=3e-3); t=time.process_time()
    for e in range(bc_epochs):
        for g in opt.param_groups: g["lr"]=3e-3*(1-e/bc_epochs)
        perm=rng.permutation(len(A)); tot=0
        for k in range(0,len(perm)-63,64):
            b=perm[k:k+64]
            _,lp,_=pol.evaluate_actions(join([S[i] for i in b]), torch.from_numpy(A[b]))
            loss=-lp.mean(); opt.zero_grad(); loss.backward(); opt.step(); tot+=float(loss.detach())*64
    if bc_epochs:
        s=summarise(evaluate(pol,val)); print(seed,"bc",round(tot/len(perm),3),round(time.process_time()-t,1),s.total_return,s.success,flush=True)
    model.set_logger(Logger(None,[])); t=time.process_time(); nxt=30; size=ppo.n_envs*ppo.n_steps
    while (now:=time.process_time()-t)<secs:
        model.learning_rate=lr*0.5**(model.num_timesteps/ppo.learning_rate_half_life); model._setup_lr_schedule()
        model.learn(size,log_interval=2**62,reset_num_timesteps=False,use_masking=False)
        if now>nxt:
            nxt+=30; ret=np.mean([e["r"] for e in model.ep_info_buffer]); suc=np.mean(model.ep_success_buffer)
            t0=time.process_time(); s=summarise(evaluate(pol,val)); t+=time.process_time()-t0
            print(seed,round(now),model.num_timesteps,"train %.2f %.2f"%(ret,suc),"val",s.total_return,s.success,s.reasons,"ent %.2f"%(-model.logger.name_to_value.get("train/entropy_loss",0)),flush=True)
    return model
if __name__=="__main__":
    import pickle, os
    f="/tmp/bc192g.pkl"

    (S,A),_=pickle.load(open(f,"rb"))
    run(int(sys.argv[1]),S=S,A=A,**eval("dict("+",".join(sys.argv[2:])+")"))
