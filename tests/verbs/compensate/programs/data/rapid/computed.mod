MODULE Computed
PERS tooldata tGrip:=[TRUE,[[0,0,120],[1,0,0,0]],[1.2,[0,0,60],[1,0,0,0],0,0,0]];
PERS tooldata tWorn:=[TRUE,[[0,0,120],[1,0,0,0]],[1.2,[0,0,60],[1,0,0,0],0,0,0]];
PERS wobjdata wTable:=[FALSE,TRUE,"",[[100,-50,200],[0.9659258,0,0,0.2588190]],[[10,20,30],[1,0,0,0]]];
PERS wobjdata wSeen:=[FALSE,TRUE,"",[[100,-50,200],[0.9659258,0,0,0.2588190]],[[10,20,30],[1,0,0,0]]];
PERS robtarget p10:=[[444.1713,110.7544,276.5597],[0.134127152,0.210626339,0.957078269,0.147131365],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p20:=[[405.2461,-174.6769,218.5084],[0.006615892,-0.182508885,0.979806734,-0.081397178],[-1,-1,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p30:=[[330.8324,-175.178,203.3934],[0.036906629,-0.366321809,-0.928822779,-0.041647068],[-1,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p40:=[[466.5471,228.4064,226.9565],[0.220209857,-0.471256649,0.846339026,0.114608216],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p50:=[[511.1235,101.8048,279.6603],[0.072605915,-0.772892962,-0.608688215,-0.163900907],[0,0,1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p60:=[[382.687,374.4945,442.2424],[0.608500682,-0.691424468,-0.053524914,-0.385738523],[0,-1,-2,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p70:=[[343.4247,0,273.5199],[0,0,1,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS robtarget p80:=[[-296.5621,-218.068,445.6544],[0.391834412,0.861050746,-0.238575383,-0.219406456],[-2,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PERS jointtarget j10:=[[10,20,10,15,40,25],[9E9,9E9,9E9,9E9,9E9,9E9]];
PERS jointtarget j20:=[[-20,30,5,-10,50,-35],[9E9,9E9,9E9,9E9,9E9,9E9]];
PERS pose peMoved:=[[0,0,50],[1,0,0,0]];
PROC main()
  MoveJ p10,v100,fine,tGrip;
  MoveJ Offs(p10,0,0,50),v100,fine,tGrip;
  MoveL RelTool(p10,0,0,-50\Rz:=20),v100,fine,tGrip;
  MoveL CRobT(\Tool:=tGrip),v100,fine,tGrip;
  MoveAbsJ CJointT(),v100,fine,tGrip;
  p20.trans.z:=p20.trans.z+10;
  MoveL p20,v100,fine,tGrip;
  Lift p30;
  MoveL p30,v100,fine,tGrip;
  ok:=StrToVal(text,p40);
  MoveL p40,v100,fine,tGrip;
  tWorn.tframe.trans.z:=Measured();
  MoveL p10,v100,fine,tWorn;
  wSeen.oframe:=DefFrame(p50,p60,p70);
  MoveL p50,v100,fine,tGrip\WObj:=wSeen;
  j20.robax.rax_1:=10;
  MoveAbsJ j20,v100,fine,tGrip;
  MoveAbsJ j10,v100,fine,tGrip;
  PDispOn \ExeP:=p70,p80,tGrip;
  MoveL p60,v100,fine,tGrip;
  MoveAbsJ j10,v100,fine,tGrip;
  Displaced;
  PDispOff;
  MoveJ p80,v100,fine,tGrip;
  IF moved PDispSet peMoved;
  MoveL p70,v100,fine,tGrip;
  PDispOff;
  MoveL p70,v100,fine,tGrip\Corr;
  FCAct force1,tGrip;
  MoveL p70,v100,fine,tGrip;
  FCDeact;
  EGMMoveL egm1,p70,v100,fine,tGrip;
  SetDataVal "P60",value;
  MoveJ p60,v100,fine,tGrip;
  ConfJ\Off;
ENDPROC
PROC Displaced()
  MoveL p80,v100,fine,tGrip;
ENDPROC
PROC Lift(INOUT robtarget p)
  p.trans.z:=p.trans.z+100;
ENDPROC
ENDMODULE
