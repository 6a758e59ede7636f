import sys,pickle,time,numpy as np,torch
torch.set_num_threads(1)
from torch import nn
from agents.features import join, Candidates
from agents.candidate_policy import prepared
from agents.candidate_network import CandidateNetwork
from agents.segments import segments
d,v=pickle.load(open(sys.argv[4],"rb"))
def flat(d):
    S=[];A=[];Y=[];C=[]
    for c,a,b,af,col,done in d:
        for i,s in enumerate(c.split()):
            k=int(np.flatnonzero(s.action==a[i])[0])
            # only the chosen candidate is scored here: cheap training
            S.append(s._replace(offset=np.array([0,1]),action=s.action[k:k+1],features=s.features[k:k+1],sides=s.sides[k:k+1])); A.append(0); Y.append(np.log(np.clip(max(af[i],1.2 if col[i] else 0),.1,3))); C.append(col[i])
    return S,np.array(Y,np.float32),np.array(C)
S,Y,C=flat(d); VS,VY,VC=flat(v)
R=int(sys.argv[1]); hid=int(sys.argv[2]); ep=int(sys.argv[3])
torch.manual_seed(0)
net=CandidateNetwork(S[0].of_state.shape[1],hid,R,1)
head=nn.Sequential(nn.Linear(hid,hid),nn.ReLU(),nn.Linear(hid,2))
G=nn.Linear(S[0].of_state.shape[1],hid); 
Z=np.concatenate([x.features for x in S]); print("features",Z.mean(0).round(2),Z.std(0).round(2),np.abs(Z).max(0)); Z=np.concatenate([x.tetrahedra for x in S[:2000]]); print(Z.mean(0).round(2),Z.std(0).round(2),np.abs(Z).max(0))
P=[*net.parameters(),*head.parameters(),*G.parameters()]
opt=torch.optim.Adam(P,lr=3e-3)
from scipy.stats import rankdata
def auc(c,s):
    r=rankdata(s); n=c.sum(); return (r[c].sum()-n*(n+1)/2)/(n*(len(c)-n))
def out(b):
    j=join(b); seen,graph=prepared(j)
    return head(torch.relu(net._encode(seen,graph)+G(seen.of_state)))
t=time.process_time(); rng=np.random.default_rng(0); n=len(S)
now=np.array([s.of_state[0,4] for s in VS]); nowl=np.log(np.clip(now,.1,3))
print("base: var",VY.var(),"mse of no change",((VY-nowl)**2).mean(), "coll",VC.mean(),"auc of present strain",auc(VC,nowl))
for e in range(ep):
    for g in opt.param_groups: g["lr"]=3e-3*(1-e/ep)
    perm=rng.permutation(n)
    for k in range(0,n-63,64):
        b=perm[k:k+64]; o=out([S[i] for i in b]); base=torch.from_numpy(np.log(np.clip([S[i].of_state[0,4] for i in b],.1,3)).astype(np.float32))
        loss=((o[:,0]+base-torch.from_numpy(Y[b]))**2).mean()*5+nn.functional.binary_cross_entropy_with_logits(o[:,1],torch.from_numpy(C[b].astype(np.float32)))
        opt.zero_grad(); loss.backward(); opt.step()
    if e%2==1:
        with torch.no_grad(): o=torch.cat([out(VS[k:k+256]) for k in range(0,len(VS),256)]).numpy()
        print(e,round(time.process_time()-t),"mse",((o[:,0]+nowl-VY)**2).mean(),"auc strain",auc(VC,o[:,0]+nowl),"auc logit",auc(VC,o[:,1]),flush=True)
