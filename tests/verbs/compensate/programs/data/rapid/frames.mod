MODULE Frames
PERS tooldata tGrip:=[TRUE,[[0,0,120],[1,0,0,0]],[1.2,[0,0,60],[1,0,0,0],0,0,0]];
PERS tooldata tFixed:=[FALSE,[[500,0,400],[1,0,0,0]],[1,[0,0,60],[1,0,0,0],0,0,0]];
PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,100],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
PERS wobjdata wTurn:=[FALSE,FALSE,"STN_1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
PERS wobjdata wBelt:=[FALSE,FALSE,"CNV1",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
PERS wobjdata wFix:=[FALSE,TRUE,"",[[-120.5,300.25,50],[0.70710678,0,0,0.70710678]],[[0,0,0],[1,0,0,0]]];
CONST robtarget p10:=[[-189.4956,-564.6713,226.5597],[0.198879805,0.825691847,0.527821222,0.009195367],[0,0,0,0],[0,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget pTrack:=[[405.2461,-174.6769,218.5084],[0.006615892,-0.182508885,0.979806734,-0.081397178],[-1,-1,-1,0],[512.5,9E9,9E9,9E9,9E9,9E9]];
CONST jointtarget jTrack:=[[10,20,10,15,40,25],[512.5,0,9E9,9E9,9E9,9E9]];
CONST jointtarget jZone:=[[0,0,0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget pLong:=[[343.4247,0,273.5199],[0,0,1.003,0],[0,0,0,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
CONST robtarget pEmpty:=[[0,0,0],[0,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
CONST robtarget pSpare:=[[466.5471,228.4064,226.9565],[0.220209857,-0.471256649,0.846339026,0.114608216],[0,0,-1,0],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
PROC main()
  WZHomeJointDef \Inside,space1,jZone,jDelta;
  MoveJ p10,v100,fine,tGrip\WObj:=wFix;
  MoveJ pTrack,v100,fine,tGrip;
  MoveAbsJ jTrack,v100,fine,tGrip;
  MoveL pLong,v100,fine,tGrip;
  MoveL pEmpty,v100,fine,tGrip;
  MoveL pSpare,v100,fine,tFixed\WObj:=wHeld;
  MoveL pSpare,v100,fine,tGrip\WObj:=wTurn;
  MoveL pSpare,v100,fine,tGrip\WObj:=wBelt;
  MoveExtJ jTrack,v100,fine;
  IndAMove STN_1,1\ToAbsNum:=90,20;
  MoveL *,v100,fine,tGrip;
ENDPROC
ENDMODULE
