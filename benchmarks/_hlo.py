import re, sys, collections, jax, jax.numpy as jnp
from earl_jax.algos import autonomy, birth, make_algo
from earl_jax.envs import make
from earl_jax.protocol import Protocol
from earl_jax.train import per_lane
env=make("tabletop_organization"); loop=autonomy.Loop(env, Protocol(env.train_horizon, env.eval_horizon))
for algo in sys.argv[1:]:
    m=per_lane(make_algo(algo),10); keys=jax.vmap(jax.random.key)(jnp.arange(10)); cap=birth.capacity_for(loop,m,100000)
    lives=jax.jit(lambda m,k: birth.begin(loop,m,k,cap))(m,keys)
    t=jax.jit(lambda m,s: autonomy.run(loop,m,s,200),donate_argnums=1).lower(m,lives).compile().as_text()
    open(f"{sys.argv[0]}.{algo}.txt","w").write(t)
    comps=re.split(r'\n(?=%|ENTRY)',t)
    for c in sorted(comps,key=lambda c:-c.count('\n'))[:40]:
        name=c.split(' ')[0]
        if 'fused' in name or 'region' in name and 'wide' not in name and 'command' not in name: pass
        ops=collections.Counter(re.findall(r'= [^=]*? ([a-z\-]+)\(',c))
        k=sum(v for o,v in ops.items() if o in('fusion','custom-call','gemm','copy','sort','scatter','gather','dynamic-update-slice','reduce'))
        if ops.get('fusion',0)+ops.get('custom-call',0)>5: print(algo,name[:60],dict(ops))
